"""What others add by name: found, told apart, refused in a sentence, and none of it stopping the rest."""

import sys
import types
from pathlib import Path

import pytest

from frog_blender.engine.errors import FrogError
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
    with pytest.raises(FrogError, match=r"^There is no shape 'oval'; there are round\.$"):
        shapes["oval"]
    with pytest.raises(FrogError, match=r"^No shape 'oval' was registered"):
        shapes.unregister("oval")


def test_names_that_are_taken_or_are_none_are_refused(shapes: Registry[str]) -> None:
    shapes.register("oval", "circle:NAME")
    for name in ("round", "oval"):
        with pytest.raises(FrogError, match=rf"^There is a shape '{name}' already, expected another name\.$"):
            shapes.register(name, "circle:NAME")
    for name in ("", "Oval", "an oval", "x" * 65):
        with pytest.raises(FrogError, match="expected lower-case letters"):
            shapes.register(name, "circle:NAME")


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
