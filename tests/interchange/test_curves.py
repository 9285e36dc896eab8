"""What others trained with motion of its own, SpacetimeGaussians' .ply and splaTV's .splatv, against the published
formulas."""

from pathlib import Path

import numpy as np
import pytest
from support.builders import refused
from support.foreign_files import CURVES, Columns, ply, splatv, table, trained

from frog_blender.cli.main import main
from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import NumpyGaussians
from frog_blender.engine.interchange.imports import import_scene
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import read_scene, write_scene
from frog_blender.engine.spherical_harmonics import SH_DC

FRAMES = 50


def check(actual: NumpyGaussians, columns: Columns, time: float, atol: float) -> None:
    """Against the paper's equations, in double precision, at a time of the training."""
    d = time - columns["trbf_center"].astype(np.float64)[:, None]
    b = table(columns, "motion", 9)
    places = np.stack([columns[axis] for axis in "xyz"], axis=1) + b[:, :3] * d + b[:, 3:6] * d**2 + b[:, 6:] * d**3
    turns = table(columns, "rot", 4) + table(columns, "omega", 4) * d
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    seen = np.exp(-np.square(d[:, 0] / np.exp(columns["trbf_scale"].astype(np.float64))))
    opacities = seen / (1 + np.exp(-columns["opacity"].astype(np.float64)))
    np.testing.assert_allclose(actual.means, places, atol=atol)
    np.testing.assert_allclose(np.abs((actual.quaternions * turns).sum(axis=1)), 1, atol=atol)
    np.testing.assert_allclose(actual.opacities, opacities, atol=atol)
    np.testing.assert_allclose(np.log(actual.scales), table(columns, "scale", 3), atol=5 * atol)
    np.testing.assert_allclose(0.5 + SH_DC * actual.sh[:, 0], table(columns, "f_dc", 3), atol=atol)


@pytest.mark.parametrize(("suffix", "compact"), [(".ply", False), (".ply", True), (".splatv", False)])
def test_motion_is_that_of_the_formulas(tmp_path: Path, suffix: str, compact: bool) -> None:
    """At frames and between them: the curves themselves are kept."""
    columns = trained()
    content, said = splatv(columns) if suffix == ".splatv" else (ply(columns, "<f4"), columns)
    (tmp_path / f"x{suffix}").write_bytes(content)
    imported = import_scene(tmp_path / f"x{suffix}", tmp_path / "x.frog", compact=compact)
    player = ScenePlayer.load(imported.path)
    assert (imported.gaussians, imported.frames, player.header.frame_count) == (CURVES, FRAMES, FRAMES)
    assert "does not say how long" in imported.warning and player.keeps_identity
    order, kept = np.argsort(read_scene(imported.path).arrays["means"][:, 0]), np.arange(0, CURVES, 7)
    expected = {name: column[np.argsort(said["x"])] for name, column in said.items()}
    for frame in (0, 13, 21.37, 49):
        actual = player.at_frame(frame)
        check(actual.part(order), expected, frame / FRAMES, 0.03 if compact else 2e-5)
        some = player.subset(kept).at_frame(frame)
        np.testing.assert_array_equal(some.means, actual.means[kept])
        np.testing.assert_array_equal(player.delta_at(player.time_of(frame))["base"][:, 3], actual.opacities)


def test_rate_is_the_users(tmp_path: Path) -> None:
    for name, content in (("a.splatv", splatv(trained())[0]), ("b.ply", ply(trained(), "<f4"))):
        (tmp_path / name).write_bytes(content)
        assert main(["import", str(tmp_path / name), "--fps", "25"]) == 0
        assert ScenePlayer.load((tmp_path / name).with_suffix(".frog")).header.frames_per_second == 25


def without(name: str) -> bytes:
    return ply({other: column for other, column in trained().items() if other != name}, "<f4")


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("x.splatv", b"", "another kind of file, expected a .splatv"),
        ("x.splatv", b"PK" + splatv(trained())[0][2:], "another kind of file, expected a .splatv"),
        ("x.splatv", splatv(trained())[0][:40], "header"),
        ("x.splatv", splatv(trained())[0][:-1], "size"),
        ("x.splatv", splatv(trained(), size=-64)[0], "size"),
        ("x.splatv", splatv(trained(), size=63)[0], "no Gaussians"),
        ("x.splatv", splatv(trained(), type="mesh")[0], "no Gaussians"),
        ("x.ply", without("motion_4"), "no motion_4"),
        ("x.ply", ply(trained() | {"f_t_0": np.zeros(CURVES, np.float32)}, "<f4"), "full model of SpacetimeGaussians"),
    ],
)
def test_damaged_and_foreign_files(tmp_path: Path, name: str, content: bytes, sentence: str) -> None:
    (tmp_path / name).write_bytes(content)
    refused(rf"^[^\n]*{name}: found [^\n]*{sentence}", import_scene, tmp_path / name, tmp_path / "x.frog")
    assert not (tmp_path / "x.frog").exists()


def test_a_moving_file_is_no_frame(tmp_path: Path) -> None:
    for frame in range(2):
        (tmp_path / f"{frame}.ply").write_bytes(ply(trained(), "<f4"))
    refused(r"0\.ply: found Gaussians that move by themselves", import_scene, tmp_path, tmp_path / "x.frog")


def test_another_network_is_not_opened(tmp_path: Path) -> None:
    """4DGaussians' training: Gaussians that stand still beside a pickle."""
    still = {name: column for name, column in trained().items() if name[:5] not in ("trbf_", "motio", "omega")}
    (tmp_path / "point_cloud.ply").write_bytes(ply(still, "<f4"))
    (tmp_path / "deformation.pth").write_bytes(b"cos\nsystem\n")
    for source in (tmp_path, tmp_path / "point_cloud.ply"):
        with pytest.raises(FrogError, match=r"4DGaussians .* deformation\.pth, expected .*export_perframe_3DGS\.py"):
            import_scene(source, tmp_path / "x.frog")


def test_damaged_curves_of_a_scene(tmp_path: Path) -> None:
    (tmp_path / "x.ply").write_bytes(ply(trained(), "<f4"))
    scene = read_scene(import_scene(tmp_path / "x.ply", tmp_path / "x.frog").path)
    curves = scene.arrays["curves"]
    curves[0], curves[1], curves[2, :9] = np.nan, np.inf, 1e25
    write_scene(tmp_path / "x.frog", scene)
    drawn = ScenePlayer.load(tmp_path / "x.frog").at_frame(7)
    assert all((np.abs(array) <= 1e18).all() for array in drawn.arrays.values()), "their squares are numbers still"
    scene.arrays["curves"] = curves[:, :14]
    write_scene(tmp_path / "x.frog", scene)
    refused(r"curves of shape \(60, 14\)", read_scene, tmp_path / "x.frog")


def test_formats_that_are_not_read_name_what_converts_them(tmp_path: Path) -> None:
    (tmp_path / "x.ksplat").write_bytes(bytes(5000))
    with pytest.raises(FrogError, match=r"found the ending '\.ksplat', expected .*\.ply.*SuperSplat"):
        import_scene(tmp_path / "x.ksplat", tmp_path / "x.frog")
