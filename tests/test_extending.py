"""docs/extending.md: its examples, written as a package of somebody else's, are found, trained, played and judged."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from support import synthetic_capture as film
from support.builders import REPOSITORY

PAGE = REPOSITORY / "docs" / "extending.md"
STEPS = 4


def blocks() -> dict[str, str]:
    """The page's code by the name of its file."""
    found = re.findall(r"```(?:python|toml)\n# ([\w./]+)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    return dict(found)


def as_written(package: Path) -> None:
    """The package, with the metadata that an installer makes of its pyproject.toml."""
    for name, code in blocks().items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(code)
    project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    metadata = package / f"{project['name']}-{project['version']}.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 1\n")
    lines = []
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    (metadata / "entry_points.txt").write_text("\n".join(lines))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package, and a capture of its reader."""
    place = tmp_path_factory.mktemp("extending")
    as_written(place / "package")
    lines = []
    for camera in film.rig():
        numbers = (camera.width, camera.height, film.FOCAL, *camera.world_to_camera.ravel())
        lines.append(" ".join([camera.name, *map(str, numbers)]))
        (place / "rig" / camera.name).mkdir(parents=True)
        for frame in range(film.FRAMES):
            cv2.imwrite(str(place / "rig" / camera.name / f"{frame}.png"), film.image(camera, frame)[..., ::-1])
    (place / "rig" / "rig.txt").write_text("\n".join(lines))
    return place


def python(place: Path, *arguments: str) -> str:
    path = os.pathsep.join(map(str, (REPOSITORY, place / "package")))
    variables = {**os.environ, "PYTHONPATH": path, "FROG_CACHE": str(place / "cache"), "OMP_NUM_THREADS": "1"}
    run = subprocess.run(
        [sys.executable, *arguments], cwd=place, env=variables, capture_output=True, text=True, timeout=500
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_examples_are_short() -> None:
    code = {name: text for name, text in blocks().items() if name.endswith(".py")}
    assert len(code) == 9 and all(len(text.splitlines()) <= 40 for text in code.values())


FROG = ("-m", "frog_blender.cli")


@pytest.fixture(scope="module")
def trained(place: Path) -> Path:
    """The folder, with a scene of the package's method in it."""
    options = ("--recipe", "draft", "--steps", str(STEPS), "--max-gaussians", "250", "--method", "linear")
    python(place, *FROG, "train", "rig", "--out", "line.frog", *options, "--sink", "csv")
    return place


def test_on_the_command_line(trained: Path) -> None:
    place = trained
    rows = (place / "training.csv").read_text().splitlines()
    assert rows and [float(row.split(",")[0]) for row in rows][-1] <= STEPS
    figures = json.loads(python(place, *FROG, "eval", "line.frog", "rig", "--metric", "mean_error", "--json"))
    assert figures["method"] == "linear" and figures["split"] == "held-out" and 0 < figures["mean_error"] < 1
    python(place, *FROG, "xyz", "line.frog", "--out", "5.xyz", "--frame", "5")
    assert np.loadtxt(place / "5.xyz").shape == (figures["gaussians"], 3)


SCRIPT = f"""
from frog_blender import engine as frog
recipe = frog.recipe("draft", losses="edges:0.5", density="prune", rasterizer="grey", densify_from=0.1)
assert frog.open_capture("rig").format == "rig"
told = []
frog.train("rig", "python.frog", recipe=recipe, steps={STEPS}, max_gaussians=250, method="linear", on_event=told.append)
scene = frog.load_scene("python.frog")
assert (scene.header.recipe["losses"], scene.header.recipe["density"]) == ("edges:0.5", "prune")
metrics = frog.evaluate(scene, "rig", metrics=["mean_error"])
assert 0 < metrics.more["mean_error"] < 1 and metrics.cameras["cam00"].more.keys() == {{"mean_error"}}
(started,) = [event for event in told if isinstance(event, frog.Started)]
assert 0 < scene.count <= started.gaussians  # the strategy only removes
assert (scene.at_frame(0).means != scene.at_frame(5).means).any()
print(scene.header.recipe["rasterizer"])
"""


def test_in_python(place: Path) -> None:
    assert python(place, "-c", SCRIPT).strip() == "grey"


def test_without_its_package_a_scene_is_refused_in_a_sentence(trained: Path) -> None:
    from frog_blender.engine import FrogError, load_scene

    with pytest.raises(FrogError, match=r"line\.frog: found the method 'linear', expected one of frog, .* package"):
        load_scene(trained / "line.frog")


WRONG = """
from pathlib import Path
from types import SimpleNamespace
from frog_blender import engine as frog
from frog_blender.engine import registry

def unplayable(arrays, model):
    raise KeyError("network.x")

registry.READERS.register("wrong", SimpleNamespace(matches=lambda folder: folder.name == "wrong", read=lambda _: {}))
registry.METRICS.register("wrong", lambda image, truth: image)
Path("wrong").mkdir()
rig, scene = frog.open_capture("rig"), frog.load_scene("line.frog")
for attempt in (
    lambda: frog.open_capture("wrong"),
    lambda: frog.evaluate(scene, rig, metrics=["wrong"]),
    lambda: frog.rasterize(SimpleNamespace(means=None), rig.cameras[0], backend=lambda *_: None),
    lambda: registry.Method("Wrong", "", unplayable).player({}, {}),
):
    try:
        attempt()
    except frog.FrogError as error:
        print(error)
"""


def test_what_is_wrong_with_what_a_package_gives_is_said_in_a_sentence(trained: Path) -> None:
    reader, metric, rasterizer, player = python(trained, "-c", WRONG).splitlines()
    assert reader == "The reader 'wrong' gave dict for wrong, expected a Capture."
    assert metric == "The metric 'wrong' gave ndarray, expected one number for an image."
    assert rasterizer.endswith("gave NoneType, expected an Image.")
    assert player == "The method Wrong cannot play what a training of it wrote (KeyError: 'network.x')."
