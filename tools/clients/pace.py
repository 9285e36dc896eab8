"""Our web page beside other viewers of the web, for a table of docs/experiments/interchange.md.

    python tools/clients/pace.py FOLDER

FOLDER is that of clients.py. The same frame is drawn in the same Chromium, in a new one for each run.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from clients import PROGRAMS, Case, Format, Refused, case_in, chromium, exported, fill_in, run, table, view_of

from frog_blender.engine.capture.camera import Camera

WIDTH, HEIGHT = 480, 360
RUNS = 3
BEFORE, MEASURED = 10, 20
"""Frames in which the camera moves; the first do not count, in which our page finds how many pixels it can draw."""
QUIET = 15  # per cent
STEP = np.radians(1.0)
PAGE_FORMAT = Format("web page", ".html", ("--html",), "as they are")
PLY_FORMAT = Format("`.compressed.ply`", ".compressed.ply", ("--compressed-ply", "--y-down"), "y down")


@dataclass(frozen=True)
class Player:
    """Attributes:
    viewer: of viewers.js, None for our page.
    sharp: our page draws all pixels while the camera moves.
    """

    name: str
    form: Format
    viewer: str | None = None
    sharp: bool = False


PLAYERS = (
    Player("our page", PAGE_FORMAT),
    Player("our page, all pixels", PAGE_FORMAT, sharp=True),
    *(Player(name, PLY_FORMAT, name) for name in ("Spark", "PlayCanvas", "GaussianSplats3D")),
)


def moved(case: Case) -> Iterator[Camera]:
    """About the middle of what the camera sees, by a degree with each frame."""
    means = case.scene.at_frame(0).means
    depths = (means - case.camera.center) @ case.camera.forward
    middle = case.camera.center + np.median(depths[depths > 0]) * case.camera.forward
    for step in range(1, BEFORE + MEASURED + 1):
        cosine, sine = np.cos(step * STEP), np.sin(step * STEP)
        turn = np.eye(4)
        turn[:2, :2] = [[cosine, -sine], [sine, cosine]]
        turn[:3, 3] = middle - turn[:3, :3] @ middle
        yield case.camera.with_pose(case.camera.world_to_camera @ np.linalg.inv(turn))


def busy(seconds: float = 2.0) -> float:
    """Per cent of the processor's time that is used, by others while nothing of ours runs."""

    def times() -> tuple[int, int]:
        numbers = [int(word) for word in Path("/proc/stat").read_text().splitlines()[0].split()[1:9]]
        return sum(numbers), numbers[3] + numbers[4]

    before = times()
    time.sleep(seconds)
    whole, idle = (after - early for after, early in zip(times(), before, strict=True))
    return 100 * (1 - idle / whole)


def quiet() -> float:
    """How busy others are once they let us measure, or after a minute."""
    start = time.monotonic()
    while (others := busy()) > QUIET and time.monotonic() - start < 60:
        pass
    return others


def measured(case: Case, player: Player, path: Path) -> dict[str, Any]:
    """One run: what pace.mjs prints, and how busy others were before."""
    axes, picture = player.form.axes, case.folder / f"moved {player.name}.png"
    views = list(moved(case))
    job: dict[str, Any] = {"width": WIDTH, "height": HEIGHT, "url": f"/{path.name}", "sharp": player.sharp}
    job |= {
        "matrices": [view_of(camera, axes)["matrix"] for camera in views],
        "before": BEFORE,
        "picture": str(picture),
    }
    if player.viewer is None:
        job["url"] += f"#camera={case.camera.name}&frame=0&plain"
    else:
        job |= {"viewer": player.viewer, **view_of(case.camera, axes)}
    jobs = case.folder / "jobs.json"
    jobs.write_text(json.dumps(job))
    others = quiet()
    said = json.loads(run("node", case.folder / "pace.mjs", jobs, environment={"FROG_CHROMIUM": chromium()}))
    print(player.name, said, flush=True)
    if "error" in said:
        raise Refused(said["error"])
    there = Case(case.folder, case.scene, views[-1]).of_picture(picture)
    print(f"{there.text} dB where the camera ends; others took {others:.0f} % before", flush=True)
    return said | {"busy": others}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder.resolve()
    case = case_in(folder, WIDTH, HEIGHT)
    paths = {form.name: exported(case, form, 100 + index).path for index, form in enumerate((PAGE_FORMAT, PLY_FORMAT))}
    versions = {program.name: program.version(folder) for program in PROGRAMS if program.package.startswith("npm")}
    found: dict[str, list[dict[str, Any]]] = {player.name: [] for player in PLAYERS}
    refused: dict[str, str] = {}
    for _ in range(RUNS):
        for player in PLAYERS:
            try:
                found[player.name].append(measured(case, player, paths[player.form.name]))
            except Refused as error:
                refused[player.name] = str(error)
    titles = ["first picture, s", "moved frame, ms", "of the processor, ms", "JS heap, MB", "page's process, MB"]
    rows = [("viewer", [*titles, "GPU process, MB"])]
    for player in PLAYERS:
        runs, name = found[player.name], f"{player.name} {versions.get(player.name, '')}".strip()
        if player.name in refused:
            rows.append((name, [f'no: "{refused[player.name]}"', *[""] * len(titles)]))
            continue
        cells = [f"{median(run['first'] for run in runs) / 1000:.2f}"]
        cells += [f"{median(median(run['frames']) for run in runs):.0f}", f"{median(run['work'] for run in runs):.0f}"]
        cells += [f"{median(run[of] for run in runs) / 1e6:.0f}" for of in ("heap", "renderer", "gpu")]
        rows.append((name, cells))
    shares = [run["busy"] for runs in found.values() for run in runs]
    fewer = median(run["sharpness"] for run in found[PLAYERS[0].name])
    notes = [
        f"- Medians of {RUNS} runs, each in a new browser, on {os.cpu_count()} cores, of which other programs took "
        f"{median(shares):.0f} % before a run ({max(shares):.0f} at most).",
        f"- Our page drew {100 * fewer:.0f} % of each side's pixels while the camera moved.",
    ]
    text = "\n\n".join([table(rows), "\n".join(notes)])
    print(text)
    fill_in("pace", text)


if __name__ == "__main__":
    main()
