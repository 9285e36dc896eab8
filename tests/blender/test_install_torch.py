"""torch by one button: a real pip, a package of ours in torch's place, whole or not at all."""

from __future__ import annotations

import os
import sys
import threading
import time
import zipfile
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from frog_blender import torch_install
from frog_blender.engine.errors import FrogError
from frog_blender.torch_install import PACKAGES, Installation, pip_command


def wheel(folder: Path, name: str, content: str = "") -> None:
    """A package of one file, as an index would serve it."""
    folder.mkdir(exist_ok=True)
    module = name.replace("-", "_")
    info = f"{module}-9.9.dist-info"
    with zipfile.ZipFile(folder / f"{module}-9.9-py3-none-any.whl", "w") as file:
        file.writestr(f"{module}/__init__.py", content)
        file.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: 9.9\n")
        file.writestr(
            f"{info}/WHEEL", "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        file.writestr(f"{info}/RECORD", "")


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


def finished(installation):
    assert installation.join(120.0)
    assert not installation.running
    return installation


def test_it_is_whole(tmp_path, index):
    before = threading.active_count()
    done = finished(Installation(tmp_path / "data" / "torch").start())
    assert done.done and not done.error
    assert (tmp_path / "data" / "torch" / "torch" / "__init__.py").read_text() == "answer = 42\n"
    assert [path.name for path in (tmp_path / "data").iterdir()] == ["torch"], "nothing is left beside it"
    assert threading.active_count() == before


def test_what_cannot_be_found_is_one_sentence_and_leaves_nothing(tmp_path, index):
    for path in index.glob("torch*"):
        path.unlink()
    failed = finished(Installation(tmp_path / "data" / "torch").start())
    assert not failed.done and "torch could not be installed" in failed.error and "\n" not in failed.error
    assert "torch" in failed.error and not list((tmp_path / "data").iterdir())


def test_an_older_one_stays_until_a_new_one_is_whole(tmp_path, index):
    folder = tmp_path / "data" / "torch"
    finished(Installation(folder).start())
    for path in index.glob("torch*"):
        path.unlink()
    assert finished(Installation(folder).start()).error
    assert (folder / "torch" / "__init__.py").is_file()


def test_cancelled_it_leaves_nothing(tmp_path, monkeypatch):
    slow = [sys.executable, "-c", "import time; print('Collecting torch', flush=True); time.sleep(60)"]
    monkeypatch.setattr(torch_install, "pip_command", lambda: slow)
    installation = Installation(tmp_path / "data" / "torch").start()
    deadline = time.monotonic() + 20
    while installation.line != "Collecting torch" and time.monotonic() < deadline:
        time.sleep(0.01)
    assert installation.line == "Collecting torch"
    installation.cancel()
    finished(installation)
    assert not installation.done and not installation.error and not list((tmp_path / "data").iterdir())


def test_no_room_is_said_before_anything_is_fetched(tmp_path, monkeypatch):
    monkeypatch.setattr(torch_install, "_ROOM", 1e18)
    with pytest.raises(FrogError, match="GB free, torch needs"):
        Installation(tmp_path / "data" / "torch").start()


def test_a_folder_that_cannot_be_written_ends_in_a_sentence(tmp_path, monkeypatch):
    """It stops being one between the first look at it and the work."""
    parent = tmp_path / "data"

    def taken(folder):
        folder.rmdir()
        folder.write_bytes(b"")
        return SimpleNamespace(free=1e12)

    monkeypatch.setattr(torch_install.shutil, "disk_usage", taken)
    failed = finished(Installation(parent / "torch").start())
    assert not failed.done and "\n" not in failed.error
    assert failed.error.startswith(f"{parent / 'torch'}: torch could not be installed (")


def test_whatever_goes_wrong_ends_in_a_sentence(tmp_path):
    failed = finished(Installation(tmp_path / "data" / "torch", packages=["torch\0"]).start())
    assert not failed.done and "torch could not be installed (ValueError" in failed.error
    assert "\n" not in failed.error and not list((tmp_path / "data").iterdir())


def test_what_pip_says_may_be_no_text(tmp_path, monkeypatch):
    speaks = [sys.executable, "-c", "import sys; sys.stdout.buffer.write(b'ERROR: caf\\xe9\\n'); sys.exit(1)"]
    monkeypatch.setattr(torch_install, "pip_command", lambda: speaks)
    failed = finished(Installation(tmp_path / "data" / "torch").start())
    assert failed.error.startswith("torch could not be installed: caf")


def test_a_python_without_pip_uses_the_one_that_it_brings_along(monkeypatch):
    real = torch_install.importlib.util.find_spec
    if real("ensurepip") is None:
        pytest.skip("this Python brings no pip along")
    monkeypatch.setattr(torch_install.importlib.util, "find_spec", lambda name: None if name == "pip" else real(name))
    command = pip_command()
    assert command[0] == sys.executable and ".whl" in command[1] and command[1].endswith("pip")


def test_nothing_is_fetched_without_online_access(empty):
    system = bpy.context.preferences.system
    allowed = system.use_online_access
    try:
        system.use_online_access = False
        assert not bpy.ops.frog.install_torch.poll()
    finally:
        system.use_online_access = allowed


def test_the_button(empty, index, tmp_path, monkeypatch):
    from frog_blender.operators import install_torch
    from frog_blender.ui import preferences

    system = bpy.context.preferences.system
    allowed, system.use_online_access = system.use_online_access, True
    monkeypatch.setattr(install_torch, "folder", lambda: tmp_path / "data" / "torch")
    paths = list(sys.path)
    try:
        if not bpy.app.online_access:
            pytest.skip("this Blender was started offline")
        assert bpy.ops.frog.install_torch() == {"FINISHED"}
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        assert bpy.app.timers.is_registered(install_torch._tick), "another file does not end it"
        system = bpy.context.preferences.system
        finished(install_torch.current)
        assert install_torch.adopt() and str(tmp_path / "data" / "torch") in sys.path
        assert preferences.site_packages(tmp_path / "data" / "torch") == tmp_path / "data" / "torch"
    finally:
        system.use_online_access = allowed
        sys.path[:] = paths
        install_torch.current = None
