"""What is installed besides, by name: the extras, what the commands say without them, and Blender in the Makefile."""

import errno
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from support.builders import REPOSITORY, printed, run_python, scene_file
from support.films import encode, numbered

from frog_blender.cli.commands import EXTRAS, unusable
from frog_blender.cli.main import main
from frog_blender.engine.errors import CaptureRefused, FrogError, told_as
from frog_blender.engine.optional_imports import importing
from frog_blender.engine.options import OPTIONS
from frog_blender.engine.scene.scene_file import write_scene

DISTRIBUTIONS = {
    "cv2": "opencv-contrib-python-headless",
    "flip_evaluator": "flip-evaluator",
    "pxr": "usd-core",
    "PIL": "pillow",
}
COMMAND = "from frog_blender.cli.main import main; sys.exit(main(sys.argv[1:]))"


def extra(name: str) -> list[str]:
    """The distributions that an extra names, with those of extras in it."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = [re.split("[><=;]", requirement)[0].strip() for requirement in project["optional-dependencies"][name]]
    inner = [found[1] for one in named if (found := re.fullmatch(r"frog-blender\[(.+)\]", one))]
    return [*named, *(one for other in inner for one in extra(other))]


HEARD = """
from pathlib import Path
from frog_blender.engine.capture.synchronization.films import find_films
from frog_blender.engine.capture.synchronization.starts import read_audio
from frog_blender.engine.capture.calibration.colmap import load_pycolmap
load_pycolmap()
assert all(abs(read_audio(film)).max() > 0.05 for film in find_films(Path(sys.argv[1]).parent))
"""


@pytest.mark.parametrize(
    ("name", "code", "words"),
    [
        ("calibrate", HEARD, ""),
        ("render", "", "render FROG --camera odd"),
        ("spz", "", "export FROG --frames :1"),
        ("spz", "", "export FROG --spz --spz-version 4"),
        ("usd", "", "export FROG --usd"),
        ("chart", "", "chart ROOM --methods static --steps 2 --scale 0.2 --set seed_gaussians=100"),
    ],
)
def test_an_extra_brings_all_that_its_commands_need(tmp_path: Path, name: str, code: str, words: str) -> None:
    """Of the packages of all extras there are those alone that this one brings. Calibration hears films."""
    scene, room = tmp_path / "x.frog", REPOSITORY / "examples" / "captures" / "room"
    write_scene(scene, scene_file())
    tone = (8000 * np.sin(np.arange(96_000) * 0.05)).astype(np.int16)[:, None]
    encode(tmp_path / "cam01.mp4", numbered(4), rate=2, sound=tone)
    out = tmp_path / ("o.usda" if name == "usd" else "o")
    words = words.replace("FROG", str(scene)).replace("ROOM", str(room))
    left_out = [module for module in EXTRAS if DISTRIBUTIONS.get(module, module) not in extra(name)]
    code = f"import sys; sys.modules.update(dict.fromkeys({left_out}))\n{code or COMMAND}"
    printed(run_python(code, *(words.split() or [scene]), "--out", out))


@pytest.mark.parametrize("module", EXTRAS)
def test_every_extra_that_is_named_brings_what_is_missing(module: str) -> None:
    for name in EXTRAS[module]:
        assert DISTRIBUTIONS.get(module, module) in extra(name)
        assert f'".[{name}]"' in unusable(ModuleNotFoundError(name=f"{module}.part"))
        assert f"`{name}`" in (REPOSITORY / "README.md").read_text(encoding="utf-8")


def test_a_package_of_nobodys() -> None:
    assert "'other' is missing; see the README" in unusable(ModuleNotFoundError(name="other"))


def test_rendering_needs_no_torch() -> None:
    assert "torch" not in extra("render")


@pytest.mark.parametrize(
    ("command", "module", "said"),
    [
        ("render --camera odd", "cv2", "images need OpenCV: pip install opencv"),
        ("export", "tqdm", 'pip install ".[render]'),
    ],
)
def test_a_command_says_what_it_wants(tmp_path: Path, command: str, module: str, said: str) -> None:
    write_scene(tmp_path / "x.frog", scene_file())
    name, *options = command.split()
    code = f"import sys; sys.modules[{module!r}] = None\n{COMMAND}"
    run = run_python(code, name, tmp_path / "x.frog", *options, "--out", tmp_path / "o")
    assert run.returncode == 1 and run.stderr.count("\n") == 1, run.stderr
    assert said in run.stderr


def test_a_package_that_is_missing_refuses_no_capture() -> None:
    with pytest.raises(FrogError) as raised, told_as(CaptureRefused), importing("cv2", "Images need it."):
        raise ModuleNotFoundError(name="cv2")
    assert type(raised.value) is FrogError


BROKEN = "raise ImportError('libtorch_cpu.so: failed to map segment from shared object', name='_C', path={path!r})\n"


@pytest.mark.parametrize(("command", "module"), [("train", "torch"), ("export", "tqdm")])
def test_a_package_that_does_not_load_need_not_be_installed(tmp_path: Path, command: str, module: str) -> None:
    """As the system says it where memory is short: nothing about pip."""
    write_scene(tmp_path / "x.frog", scene_file())
    package = tmp_path / "broken" / module
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(BROKEN.format(path=str(package / "_C.so")))
    name, *options = command.split()
    of = REPOSITORY / "examples" / "captures" / "room" if name == "train" else tmp_path / "x.frog"
    code = f"import sys; sys.path.insert(0, {str(package.parent)!r})\n{COMMAND}"
    run = run_python(code, name, of, *options, "--out", tmp_path / "o.frog")
    assert run.returncode == 1 and run.stderr.count("\n") == 1, run.stderr
    assert f"'{module}' is installed but could not be loaded (libtorch_cpu.so: failed" in run.stderr
    assert "memory" in run.stderr and "pip" not in run.stderr


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs a limit on addresses")
@pytest.mark.parametrize("megabytes", [250, 400])
def test_a_process_with_little_memory_says_so(tmp_path: Path, megabytes: int) -> None:
    """For real: torch is there, and its library finds no room."""
    pytest.importorskip("torch")
    limit = f"import resource, sys; resource.setrlimit(resource.RLIMIT_AS, ({megabytes << 20},) * 2)\n"
    capture = REPOSITORY / "examples" / "captures" / "room"
    run = run_python(limit + COMMAND, "train", capture, "--out", tmp_path / "x.frog", OPENBLAS_NUM_THREADS="1")
    assert run.returncode == 1 and run.stderr.count("\n") == 1, run.stderr
    assert "could not be loaded" in run.stderr and "Traceback" not in run.stderr and not list(tmp_path.iterdir())


def test_memory_that_the_system_refuses_is_no_matter_of_files(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))

    monkeypatch.setattr("frog_blender.engine.interchange.imports.import_scene", refuse)
    (tmp_path / "x.ply").touch()
    assert main(["import", str(tmp_path / "x.ply")]) == 1
    assert "frog: out of memory (" in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
@pytest.mark.parametrize("target", ["test-blender", "tour"])
@pytest.mark.parametrize("name", ["BLENDER", "FROG_BLENDER"])
def test_the_makefile_takes_a_blender_by_either_name(target: str, name: str) -> None:
    command = ["make", "-n", target, f"{name}=/somewhere/blender"]
    here = {key: value for key, value in os.environ.items() if "BLENDER" not in key and "MAKE" not in key}
    said = printed(subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, env=here))
    assert re.search(r"^([A-Z_]+=\S+ )?/somewhere/blender .*--factory-startup", said, re.MULTILINE)


def test_panel_and_readme_expect_the_same_of_the_standard_recipe() -> None:
    _, meaning = OPTIONS["recipe"].items["standard"]
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    assert "three to ten minutes on a CPU" in meaning and "`standard` three to ten, and" in readme
