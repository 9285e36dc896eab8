"""What a scene has of the subject of a capture's masks, and what it has beside it, as a JSON line.

    python benchmarks/masks.py SCENE.frog CAPTURE [--key green]

SCENE was trained with the masks, or without (`frog train --masks off`). ``masked_captures.py`` makes captures with
masks. Of held-out images:

- ``inside``: PSNR of the subject's pixels against the images that the scene was trained on, in dB.
- ``elsewhere``: the share of pixels, farther from the subject than MARGIN, that the scene covers by a twentieth or
  more.

And of the scene, of Gaussians that show, at all frames or TIMES of them:

- ``background``: those that are outside the visual hull of all training masks at every time at which they show.
- ``beyond``: the share of their opacity that is outside the hull at its time: what of the subject is out of place.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frog_blender.engine.capture.hull import VisualHull
from frog_blender.engine.capture.masking import MaskSettings
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.video import load_opencv
from frog_blender.engine.evaluation.evaluate import as_trained, held_out_shots
from frog_blender.engine.evaluation.metrics import psnr_of
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw

SUBJECT = 127  # alpha above which a pixel is the subject's, of 255
MARGIN = 0.03  # of the longer side
SHOWS, COVERED = 0.05, 0.05  # opacity and alpha
TIMES = 60  # at which the hull is compared, at most

Bools = NDArray[np.bool_]


class Measured:
    """A scene beside its capture with the masks, and the images that it was trained on."""

    def __init__(self, scene: ScenePlayer, folder: Path, masks: MaskSettings) -> None:
        self._scene = scene
        self._masked = as_trained(scene.header, open_capture(folder, masks=masks))
        self._trained = as_trained(scene.header, open_capture(folder, masks=scene.header.masks))
        self._mattes, self._images = FrameStore.open(self._masked), FrameStore.open(self._trained)

    def figures(self) -> dict[str, float]:
        """See above."""
        error = inside = covered = outside = 0.0
        for index in held_out_shots(self._scene, self._masked):
            shot = self._masked.shots[index]
            drawn = draw(
                self._scene.at(self._masked.time_of(shot)),
                self._trained.cameras[shot.camera],
                self._scene.header.background,
            )
            subject = self._subject(index)
            wrong = (drawn.rgb.clip(0, 1)[subject] - self._images.image(index)[subject] / 255.0) ** 2
            error, inside = error + float(wrong.mean(axis=1).sum()), inside + float(subject.sum())
            far = ~grown(subject)
            covered, outside = covered + float((drawn.alpha[far] >= COVERED).sum()), outside + float(far.sum())
        return {
            "inside": round(psnr_of(error / inside), 2),
            "elsewhere": round(covered / outside, 5),
            **self._beyond(),
        }

    def _subject(self, shot: int) -> Bools:
        alpha = self._mattes.alpha(shot)
        assert alpha is not None, "the capture has no masks"
        return alpha > SUBJECT

    def _beyond(self) -> dict[str, float]:
        hull = VisualHull(self._masked, self._mattes, self._masked.train_indices)
        shown, beyond = np.zeros(self._scene.count), np.zeros(self._scene.count)
        for frame in [hull.frames[int(k)] for k in np.unique(np.linspace(0, len(hull.frames) - 1, TIMES).round())]:
            gaussians = self._scene.at(hull.time_of(frame))
            weight = np.where(gaussians.opacities > SHOWS, gaussians.opacities, 0)
            shown += weight
            beyond += weight * ~hull.contains_at(gaussians.means.astype(np.float64), frame)[0]
        never = (shown > 0) & (beyond >= shown * (1 - 1e-6))
        return {"background": int(never.sum()), "beyond": round(float(beyond.sum() / shown.sum()), 4)}


def grown(mask: Bools) -> Bools:
    """By MARGIN."""
    reach = max(1, round(MARGIN * max(mask.shape)))
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return np.asarray(load_opencv().dilate(np.where(mask, np.uint8(1), np.uint8(0)), kernel) > 0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("scene", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--key", help="a chroma key instead of masks, see frog train --key")
    options = parser.parse_args()
    scene = ScenePlayer.load(options.scene)
    found = Measured(scene, options.capture, MaskSettings(True, options.key)).figures()
    size = {"gaussians": scene.count, "kilobytes": round(options.scene.stat().st_size / 1000)}
    print(json.dumps({"scene": options.scene.name, **size, **found}))


if __name__ == "__main__":
    main()
