"""What loggers draw over the steps of a training."""

from frog_blender.engine import Evaluated, Event, Progress, Statistics


def scalars(event: Event) -> dict[str, float]:
    """An event's figures by name; none where it has none."""
    match event:
        case Progress():
            return {
                "loss/mean": event.loss,
                "gaussians/all": event.gaussians,
                "gaussians/dynamic": event.num_dynamic,
                "time/seconds": event.seconds,
            }
        case Statistics():
            losses = {f"loss/{name}": value for name, value in event.losses.items()}
            rates = {f"rate/{name}": value for name, value in event.rates.items()}
            return losses | rates | {"gaussians/added": event.added, "gaussians/removed": event.removed}
        case Evaluated():
            return {f"psnr_db/{event.split}": event.psnr}
        case _:
            return {}
