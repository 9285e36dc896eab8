"""torch and what calibration needs, each by one button: whole or not at all. By a real pip with a
package of ours in torch's place, or by what stands in for it."""

import os
import socket
import subprocess
import sys
import tarfile
import threading
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from support.builders import refused, refuses, until
from support.training_panel import finish, switched_off
from support.wheels import wheel

from frog_blender.engine.errors import FrogError
from frog_blender.engine.training.session.cancel_token import CancelToken
from frog_blender.tasks import background_task, installation, package_folders
from frog_blender.tasks.installation import Installation
from frog_blender.tasks.package_folders import clear_remains, has_package, installed, remove
from frog_blender.tasks.packages import (
    BYTES_NEEDED,
    CPU,
    CUDA,
    NO_TORCH,
    PACKAGES,
    has_pycolmap_wheel,
    index_needed,
    suitable_build,
)
from frog_blender.tasks.training_request import TrainingRequest

ROOT = Path(__file__).resolve().parents[2]


def packaged(folder):
    """A folder with what stands for torch in it."""
    (folder / "torch").mkdir(parents=True)
    (folder / "torch" / "__init__.py").touch()
    return folder


@pytest.fixture
def index(tmp_path, monkeypatch):
    """Packages that pip finds in place of the real ones, and no network."""
    for name in PACKAGES:
        wheel(tmp_path / "wheels", name, "answer = 42\n")
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)  # this computer's may hold torch to a version
    monkeypatch.delenv("PIP_CONSTRAINT", raising=False)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "wheels"))
    return tmp_path / "wheels"


def test_it_is_whole_and_nothing_in_the_current_folder_runs_in_pips_place(tmp_path, index, monkeypatch):
    trap = tmp_path / "downloads"
    trap.mkdir()
    for name in ("pip", "json", "runpy", "threading", "sitecustomize"):
        (trap / f"{name}.py").write_text(f"open({str(tmp_path / 'caught')!r}, 'w').write({name!r})\n")
    monkeypatch.chdir(trap)
    monkeypatch.setenv("PYTHONPATH", str(trap))
    before = threading.active_count()
    done = finish(Installation(tmp_path / "data" / "torch").start())
    assert done.result is not None and not done.error and not (tmp_path / "caught").exists()
    assert (tmp_path / "data" / "torch" / "torch" / "__init__.py").read_text() == "answer = 42\n"
    assert [path.name for path in (tmp_path / "data").iterdir()] == ["torch"], "nothing is left beside it"
    assert threading.active_count() <= before, "others may have ended meanwhile"


def test_what_cannot_be_found_is_one_sentence_and_leaves_nothing(tmp_path, index):
    """And an older one stays."""
    for path in index.glob("torch*"):
        path.unlink()
    older = packaged(tmp_path / "data" / "torch")
    failed = finish(Installation(tmp_path / "data" / "torch").start())
    assert failed.result is None and "torch could not be installed" in failed.error and "\n" not in failed.error
    assert [path.name for path in (tmp_path / "data").iterdir()] == ["torch"] and has_package(older)


@pytest.mark.parametrize("cancelled", [False, True], ids=["done", "cancelled"])
def test_what_pip_unpacks_lies_on_the_disk_that_is_installed_on_and_goes(tmp_path, stands_in, cancelled):
    """pip, which is ended without clearing up, leaves gigabytes where it unpacks. Cancelled, it leaves nothing."""
    code = f"""
import pathlib, sys, tempfile, time
torch = pathlib.Path(sys.argv[sys.argv.index("--target") + 1]) / "torch"
torch.mkdir()
(torch / "__init__.py").touch()
print(tempfile.mkdtemp(), flush=True)
time.sleep(60 * {cancelled:d})
"""
    data = tmp_path / "data"
    stands_in(code)
    task = Installation(data / "torch").start()
    until(lambda: task.pump() and task.progress.stage != "Starting")
    if cancelled:
        task.cancel()
    unpacked = Path(finish(task).progress.stage)
    assert unpacked.is_relative_to(data) and not unpacked.exists()
    assert [str(path.relative_to(data)) for path in sorted(data.rglob("*"))] == (
        [] if cancelled else ["torch", "torch/torch", "torch/torch/__init__.py"]
    )


def test_no_room_is_said_before_anything_is_fetched(tmp_path, monkeypatch):
    monkeypatch.setitem(BYTES_NEEDED, CUDA, 1e18)
    refused("GB free, torch needs", Installation(tmp_path / "data" / "torch", CUDA).start)


def test_a_source_package_is_not_run(tmp_path, index):
    """Its setup.py could do anything."""
    (index / "torch-9.9-py3-none-any.whl").unlink()
    source = tmp_path / "torch-9.9"
    source.mkdir()
    (source / "setup.py").write_text(f"open({str(tmp_path / 'caught')!r}, 'w')\n")
    (source / "PKG-INFO").write_text("Metadata-Version: 2.1\nName: torch\nVersion: 9.9\n")
    with tarfile.open(index / "torch-9.9.tar.gz", "w:gz") as archive:
        archive.add(source, "torch-9.9")
    failed = finish(Installation(tmp_path / "data" / "torch").start())
    assert failed.result is None and failed.error and not (tmp_path / "caught").exists()


BRINGS_WHAT_IT_IS_ASKED_FOR = """
import pathlib, sys
asked = [word for word in sys.argv if word.startswith(("pycolmap", "torch"))]
for name in asked:
    package = pathlib.Path(sys.argv[sys.argv.index("--target") + 1]) / name.split("=")[0]
    package.mkdir()
    (package / "__init__.py").touch()
"""


@pytest.fixture
def stands_in(monkeypatch):
    """A function after which a program stands in for pip."""
    return lambda code: monkeypatch.setattr(installation, "pip_command", lambda: [sys.executable, "-c", code])


@pytest.fixture
def folder(tmp_path, stands_in):
    """An installation of torch, by what brings it at once."""
    stands_in(BRINGS_WHAT_IT_IS_ASKED_FOR)
    folder = tmp_path / "data" / "torch"
    finish(Installation(folder).start())
    return folder


def test_what_is_removed_while_in_use_goes_at_the_next_start(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(__file__=str(folder / "torch" / "__init__.py")))
    assert not remove(folder) and installed(folder) is None and folder.is_dir(), "it is not offered any more"
    monkeypatch.delitem(sys.modules, "torch")
    clear_remains(folder)
    assert not list(folder.parent.iterdir())


def test_what_another_blender_trains_with_stays_until_that_ends(folder):
    code = f"""
import sys; sys.path[:0] = {[str(folder), str(ROOT), *sys.path]!r}
from frog_blender.tasks import package_folders
package_folders.hold()
print("held", flush=True)
sys.stdin.read()
"""
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        second = finish(Installation(folder).start())
        clear_remains(folder)
        assert second.result is not None and installed(folder) == second.result and has_package(folder)
    clear_remains(folder)
    assert not folder.exists() and installed(folder) == second.result


def test_a_training_holds_its_torch_before_it_imports_it(addon, tmp_path, monkeypatch):
    def hold():
        raise FrogError("Asked.")

    monkeypatch.setattr(package_folders, "hold", hold)
    refused("Asked", TrainingRequest(tmp_path, tmp_path / "a.frog").events, CancelToken())


@pytest.fixture
def own_folder(tmp_path, monkeypatch):
    """Where the add-on's torch lies, among a user's files of the test's own."""
    (tmp_path / "user").mkdir()
    monkeypatch.setenv("BLENDER_USER_DATAFILES", str(tmp_path / "user"))
    return installation.folder()


def test_leftovers_go_at_the_next_start(empty, own_folder):
    data = own_folder.parent
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    goes = [data / "torch.partial-abc", data / f"torch.partial-{dead.pid}-abc"]
    stays = [data / f"torch.partial-{os.getpid()}-abc", data / "torchaudio", data / "torch"]
    for path in [*goes, *stays]:
        packaged(path)
    with switched_off():
        """As at the next start."""
    until(lambda: sorted(data.iterdir()) == sorted(stays))


@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGKILL")
def test_pip_ends_with_the_process_that_started_it(tmp_path):
    """An index that takes the question and never answers: pip waits for minutes, but not without Blender."""
    server = socket.create_server(("127.0.0.1", 0))
    server.settimeout(60)
    address = f"http://127.0.0.1:{server.getsockname()[1]}/"
    code = f"""
import os, sys; sys.path[:0] = {[str(ROOT), *sys.path]!r}
from pathlib import Path
from frog_blender.engine.io.pip import run_pip
folder = Path({str(tmp_path)!r}) / f"torch.partial-{{os.getpid()}}-x"
folder.mkdir()
arguments = ["--index-url", {address!r}, "--timeout", "100", "--target", str(folder), "torch"]
run_pip(["install", *arguments], folder)
"""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PIP_")}
    environment |= {"PIP_CONFIG_FILE": os.devnull, "no_proxy": "*"}
    blender = subprocess.Popen([sys.executable, "-c", code], env=environment)
    try:
        asked, _ = server.accept()
        asked.settimeout(30)
        assert b"/torch/" in asked.recv(4096)
        blender.kill()
        assert asked.recv(4096) == b"", "pip has hung up"
    finally:
        blender.kill()
        blender.wait()
        server.close()
    clear_remains(tmp_path / "torch")
    assert not list(tmp_path.glob("torch.partial-*"))


@pytest.fixture
def online():
    """Online Access, for as long as a test lasts."""
    system = bpy.context.preferences.system
    allowed, system.use_online_access = system.use_online_access, True
    if not bpy.app.online_access:
        pytest.skip("this Blender was started offline")
    yield
    bpy.context.preferences.system.use_online_access = allowed


def test_the_button(empty, index, own_folder, online, monkeypatch):
    from frog_blender.ui import torch_environment

    monkeypatch.setattr(sys, "path", list(sys.path))
    assert bpy.ops.frog.install_torch() == {"FINISHED"}
    finish(Installation.current())
    assert background_task.tick() is None and str(own_folder) in sys.path
    assert torch_environment.site_packages(own_folder) == own_folder


def test_a_build_that_the_usual_index_lacks_is_not_replaced_by_another(empty, own_folder, online, monkeypatch):
    from frog_blender.operators import install_torch

    asked = []
    monkeypatch.setattr(Installation, "__init__", lambda _task, *given: asked.append(given[1:3]))
    monkeypatch.setattr(Installation, "begin", lambda _task: None)
    monkeypatch.setattr(install_torch, "index_needed", lambda build: "Elsewhere." if build == "CPU" else "")
    refuses("Nothing was downloaded", bpy.ops.frog.install_torch, build="CPU")
    assert bpy.ops.frog.install_torch(build="CPU", index="file:///there") == {"FINISHED"}
    assert bpy.ops.frog.install_torch(build="CUDA") == {"FINISHED"}
    assert asked == [("CPU", ["--extra-index-url", "file:///there"]), ("CUDA", [])]


def test_it_can_be_removed(empty, own_folder, tmp_path, monkeypatch):
    assert not bpy.ops.frog.remove_torch.poll()
    for name in ("torch", "torch-2", "calibration"):
        packaged(own_folder.with_name(name))
    calibration = str(own_folder.with_name("calibration"))
    monkeypatch.setattr(sys, "path", [*sys.path, calibration, str(own_folder.with_name("torch-2"))])
    assert bpy.ops.frog.remove_torch() == {"FINISHED"}
    assert [path.name for path in own_folder.parent.iterdir()] == ["calibration"]
    assert calibration in sys.path and str(own_folder.with_name("torch-2")) not in sys.path


def test_what_calibration_needs_is_installed_by_itself(tmp_path, stands_in):
    folder = tmp_path / "data" / "calibration"
    stands_in(BRINGS_WHAT_IT_IS_ASKED_FOR)
    done = finish(Installation(folder, NO_TORCH).start())
    assert done.result and not done.error and installed(folder) == folder
    assert (folder / "pycolmap" / "__init__.py").is_file() and not (folder / "torch").exists()
    again = finish(Installation(folder, NO_TORCH).start())
    assert installed(folder) == again.result == folder.with_name("calibration-2") and not folder.exists()


def test_pycolmap_that_did_not_come_is_named(tmp_path, stands_in):
    stands_in("print('all is well')")
    failed = finish(Installation(tmp_path / "data" / "calibration").start())
    assert failed.error == "pycolmap could not be installed: pip brought none (all is well)."


def test_what_suits_the_computer_is_known():
    there = [("linux", "x86_64"), ("win32", "AMD64"), ("darwin", "arm64")]
    missing = [("linux", "aarch64"), ("darwin", "x86_64"), ("win32", "ARM64")]
    assert all(has_pycolmap_wheel(*computer) for computer in there)
    assert not any(has_pycolmap_wheel(*computer) for computer in missing)
    assert suitable_build("linux", False) == suitable_build("win32", False) == suitable_build("darwin", True) == CPU
    assert suitable_build("linux", True) == suitable_build("win32", True) == CUDA
    assert "for the CPU comes from PyTorch's own" in index_needed(CPU, "linux") and index_needed(CUDA, "linux") == ""
    assert "with CUDA comes from PyTorch's own" in index_needed(CUDA, "win32") and index_needed(CPU, "win32") == ""
    assert index_needed(CPU, "darwin") == ""


def test_nothing_is_downloaded_without_online_access(empty, online):
    bpy.context.preferences.system.use_online_access = False
    for operator in (bpy.ops.frog.install_torch, bpy.ops.frog.install_calibration):
        assert not operator.poll()
