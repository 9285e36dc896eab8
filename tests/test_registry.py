"""What others add by name: found, told apart, refused in a sentence; and the examples of docs/extending.md."""

import json
import os
import re
import subprocess
import sys
import tomllib
import types
from pathlib import Path

import cv2
import numpy as np
import pytest
from support import synthetic_capture as film
from support.builders import REPOSITORY, printed, refused

from frog_blender.engine.errors import FrogError, UsageError
from frog_blender.engine.notices import Notice
from frog_blender.engine.registry import METHODS, Registry


@pytest.fixture
def shapes(monkeypatch: pytest.MonkeyPatch) -> Registry[str]:
    module = types.ModuleType("circle")
    module.NAME, module.NUMBER = "a circle", 3  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "circle", module)
    return Registry("shape", "frog_blender.shapes", ("upper",), {"round": "circle:NAME"})


def install(folder: Path, package: str, points: str) -> None:
    """A package of that name, as an installer leaves its metadata."""
    metadata = folder / f"{package}-1.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1\n")
    (metadata / "entry_points.txt").write_text(f"[frog_blender.shapes]\n{points}\n")


def test_every_method_has_what_it_names() -> None:
    pytest.importorskip("torch")
    for name in METHODS:
        method = METHODS[name]
        for reference in (method.build, method.play, method.adapt):
            assert reference is None or callable(method._function(reference)), name


def test_registered_ones_are_found_after_ours_until_they_are_taken_back(shapes: Registry[str]) -> None:
    shapes.register("oval", "circle:NAME")
    assert list(shapes) == ["round", "oval"]
    assert "oval" in shapes and "cube" not in shapes
    assert shapes["oval"] == shapes["round"] == "a circle"
    shapes.unregister("oval")
    assert list(shapes) == ["round"]
    with pytest.raises(UsageError, match=r"^There is no shape 'oval'; there are round\.$"):
        shapes["oval"]
    refused(r"^No shape 'oval' was registered", shapes.unregister, "oval")


def test_names_that_are_taken_or_are_none_are_refused(shapes: Registry[str]) -> None:
    shapes.register("oval", "circle:NAME")
    for name in ("round", "oval"):
        refused(rf"^There is a shape '{name}' already, expected another name\.$", shapes.register, name, "circle:NAME")
    for name in ("", "Oval", "an oval", "x" * 65):
        refused("expected lower-case letters", shapes.register, name, "circle:NAME")


def test_installed_ones_are_found_by_their_metadata(
    shapes: Registry[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert list(shapes) == ["round"]  # before the folder is looked in
    install(tmp_path, "ovals", "oval = circle:NAME")
    monkeypatch.syspath_prepend(tmp_path)
    assert list(shapes) == ["round", "oval"] and shapes["oval"] == "a circle"


def test_what_is_broken_is_named_in_a_sentence_and_stops_nobody(
    shapes: Registry[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "torn.py").write_text("raise RuntimeError('half of it\\nis missing')")
    install(tmp_path, "broken", "torn = torn:NAME\nnowhere = circle:OTHER\nnumber = circle:NUMBER\nboth = circle:NAME")
    install(tmp_path, "again", "both = circle:NAME\nround = circle:NUMBER\noval = circle:NAME")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.warns(Notice, match=r"^The package again offers a shape 'round': the name is taken\.$"):
        assert list(shapes) == ["round", "both", "nowhere", "number", "oval", "torn"]
    for name, sentence in {
        "torn": r"^The shape 'torn' of the package broken cannot be loaded: RuntimeError \(half of it is missing\)\.$",
        "nowhere": r"^The shape 'nowhere' of the package broken cannot be loaded: AttributeError",
        "number": r"^The shape 'number' of the package broken is a int without upper, expected what docs/extending\.md",
        "both": r"^The shape 'both' is offered by (again and broken|broken and again), expected one package alone\.$",
    }.items():
        with pytest.raises(FrogError, match=sentence):
            shapes[name]
    assert shapes["round"] == shapes["oval"] == "a circle"


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
    command = [sys.executable, *arguments]
    return printed(subprocess.run(command, cwd=place, env=variables, capture_output=True, text=True, timeout=500))


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


FAILING = f"""
import guest.edges, guest.linear, guest.mean_error, guest.rig
from frog_blender import engine as frog
from frog_blender.cli.main import main

rig, recipe = frog.open_capture("rig"), frog.recipe("draft", losses="edges:0.5")
frog.train(rig, "edges.frog", recipe=recipe, steps={STEPS}, max_gaussians=250)
guest.edges.sum = guest.mean_error.abs = guest.rig.map = guest.linear.GaussianArrays = None
for attempt in (
    lambda: frog.open_capture("rig"),
    lambda: frog.evaluate(frog.load_scene("edges.frog"), rig, metrics=["mean_error"]),
    lambda: frog.train(rig, "edges.frog", steps={2 * STEPS}, resume=True),
):
    try:
        attempt()
    except frog.FrogError as error:
        print(type(error.__cause__).__name__, error)
print(main("render line.frog --camera cam00 --frames 0:1 --out out --log log".split()))
del guest.edges.sum
print(frog.train(rig, "edges.frog", steps={2 * STEPS}, resume=True).steps)
"""


def test_an_error_in_a_package_is_a_sentence_that_says_where(trained: Path) -> None:
    *told, status, steps = python(trained, "-c", FAILING).splitlines()
    for sentence, module in zip(told, ("rig", "mean_error", "edges"), strict=True):
        where = rf"TypeError The package's module guest\.{module} failed in line \d+ \(TypeError: "
        assert re.match(where, sentence)
    assert (status, steps) == ("1", str(2 * STEPS))  # the checkpoint is as it was
    assert re.search(r"Traceback .*guest/linear\.py.*TypeError", (trained / "log").read_text(), re.S)
