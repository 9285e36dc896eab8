"""Animated USD: what usd-core reads is what playback plays, and anybody's file becomes a scene."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import foreign_files
from support.builders import odd_camera, refused
from support.foreign_takes import HALF, assert_equal_within, assert_plays_alike

from frog_blender.cli.main import main
from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.interchange.imports import import_scene, open_source
from frog_blender.engine.interchange.take import Sound, scene_take
from frog_blender.engine.interchange.usd_export import write_usd
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.transform import transform

pxr = pytest.importorskip("pxr", reason="needs usd-core")
from pxr import Gf, Sdf, Usd, UsdGeom, Vt  # noqa: E402

try:
    from pxr import UsdVol

    SCHEMA = UsdVol.ParticleField3DGaussianSplat
except (ImportError, AttributeError):  # a Blender's before 5.3
    pytest.skip("this USD does not know the schema", allow_module_level=True)

FRAMES = [0, 1, 3, 6]


def written(scene: ScenePlayer, path: Path, **options: bool) -> Path:
    assert list(write_usd(path, scene_take(scene, "my scene", range(7)), **options)) == [1, 2, 3, 4, 5, 6, 7]
    return path


def read(prim: Usd.Prim, code: float) -> GaussianArrays:
    """A prim's Gaussians, by the schema's own class."""
    splats = SCHEMA(prim)

    def value(name: str) -> np.ndarray:
        single, half = (getattr(splats, f"Get{name}{suffix}Attr")() for suffix in ("", "h"))
        return np.array((single if single.HasAuthoredValue() else half).Get(code), np.float32)

    means, turns, scales, opacities = map(value, ("Positions", "Orientations", "Scales", "Opacities"))
    coefficients = (splats.GetRadianceSphericalHarmonicsDegreeAttr().Get() + 1) ** 2
    colors = value("RadianceSphericalHarmonicsCoefficients").reshape(-1, coefficients, 3)
    return GaussianArrays(means, np.roll(turns, 1, axis=1), scales, opacities, colors)


@pytest.mark.parametrize(("suffix", "full"), [(".usdc", False), (".usda", True)])
def test_every_frame_is_what_plays(scene: ScenePlayer, tmp_path: Path, suffix: str, full: bool) -> None:
    stage = Usd.Stage.Open(str(written(scene, tmp_path / f"out{suffix}", full_precision=full)))
    dynamic, static = (stage.GetPrimAtPath(f"/my_scene/{name}") for name in ("Dynamic", "Static"))
    assert not any(attribute.GetNumTimeSamples() for attribute in static.GetAttributes())
    relative, absolute = (1e-6, 1e-6) if full else (HALF, 2.0**-14)
    for frame in range(7):
        expected = scene.at_frame(frame)
        for prim, rows in ((dynamic, slice(0, 25)), (static, slice(25, 40))):
            assert_equal_within(read(prim, frame + 1), expected.part(rows), relative, absolute)
    first = read(dynamic, Usd.TimeCode.Default())
    assert_equal_within(first, scene.at_frame(0).part(slice(0, 25)), relative, absolute)  # what readers of stills show
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (1, 7, 24)
    assert static.GetCustomDataByKey("frog:colorSpace") == "srgb-rec709-display"


def test_turns_between_two_frames_are_the_short_way(scene: ScenePlayer, tmp_path: Path) -> None:
    stage = Usd.Stage.Open(str(written(scene, tmp_path / "out.usdc")))
    attribute = stage.GetPrimAtPath("/my_scene/Dynamic").GetAttribute("orientationsh")
    turns = np.array([np.array(attribute.Get(code), np.float32) for code in range(1, 8)])
    assert ((turns[1:] * turns[:-1]).sum(axis=-1) >= 0).all()


def test_usds_own_validators_find_nothing(scene: ScenePlayer, tmp_path: Path) -> None:
    validation = pytest.importorskip("pxr.UsdValidation")
    stage = Usd.Stage.Open(str(written(scene, tmp_path / "out.usdc")))
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    actual = validation.ValidationContext(validators).Validate(stage)
    assert len(validators) > 10 and not [error.GetName() for error in actual]


def test_cameras_see_what_they_saw(scene: ScenePlayer, tmp_path: Path) -> None:
    """USD's own frustum projects points to the pixels that ours does, an off-centre principal point included."""
    stage = Usd.Stage.Open(str(written(scene, tmp_path / "out.usdc")))
    points = np.random.default_rng(0).uniform(-1, 1, (20, 3)) + odd_camera().center + 4 * odd_camera().forward
    camera = odd_camera()
    prim = next(p for p in stage.Traverse() if p.GetCustomDataByKey("frog:camera") == camera.name)
    frustum = UsdGeom.Camera(prim).GetCamera(1.0).frustum
    matrix = np.array(frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix())
    clip = np.concatenate([points, np.ones((20, 1))], axis=1) @ matrix
    actual = (clip[:, :2] / clip[:, 3:] * (0.5, -0.5) + 0.5) * (camera.width, camera.height)
    np.testing.assert_allclose(actual, camera.project(points)[0], atol=1e-3)


def test_cameras_come_back(scene: ScenePlayer, tmp_path: Path) -> None:
    path = written(scene, tmp_path / "x.usdc")
    actual = ScenePlayer.load(import_scene(path, tmp_path / "back.frog").path).header.cameras
    assert [camera.name for camera in actual] == ["odd", "plain", "plain_2"], "two have the same name"
    for camera, before in zip(actual, scene.header.cameras, strict=True):
        assert (camera.width, camera.height) == (before.width, before.height)
        np.testing.assert_allclose(camera.intrinsics, before.intrinsics, rtol=1e-5, atol=1e-3)
        np.testing.assert_allclose(camera.world_to_camera, before.world_to_camera, atol=1e-6)


def test_cameras_of_another_program(scene: ScenePlayer, tmp_path: Path) -> None:
    """With y up, in what moves: where it is at the first frame. What is no pinhole camera is left out."""
    text = foreign_files.usd(scene.at_frame(2))
    broken = 'def Camera "Broken"\n    {\n        float focalLength = -3\n    }\n\n    def Camera "Standing"'
    flat = 'def Camera "Flat"\n    {\n        token projection = "orthographic"\n    }\n\n    def Xform "Copy"'
    text = text.replace('def Camera "Standing"', broken).replace('def Xform "Copy"', flat)
    (tmp_path / "x.usda").write_text(text)
    back = ScenePlayer.load(import_scene(tmp_path / "x.usda", tmp_path / "back.frog").path)
    x, y, z = scene.at_frame(2).means.T
    farthest = x.max(), -z.min(), y.max() + 1  # the copy lies lower, and nearer
    np.testing.assert_allclose(back.at_frame(0).means.max(axis=0), farthest, atol=1e-4)
    cameras = {camera.name: camera for camera in back.header.cameras}
    assert set(cameras) == {"OnCart", "OnCart_2", "Standing"}
    on_cart, standing = cameras["OnCart"], cameras["Standing"]
    assert (on_cart.width, on_cart.height) == (1920, 1280)
    np.testing.assert_allclose(on_cart.center, (0, -8, 1), atol=1e-9)  # (0, 1, 8) with y up
    np.testing.assert_allclose(on_cart.forward, (0, 1, 0), atol=1e-9)
    np.testing.assert_allclose(on_cart.intrinsics[0, 0], 50 / 36 * 1920, rtol=1e-6)
    np.testing.assert_allclose(standing.center, (0, 0, 5), atol=1e-9)
    np.testing.assert_allclose(standing.forward, (0, 0, 1), atol=1e-9)
    np.testing.assert_allclose(standing.intrinsics[:2, 2], (1920 * (0.5 - 1 / 20), 480), rtol=1e-6)


def test_a_moving_camera_and_a_moving_root_have_time_samples(tmp_path: Path) -> None:
    from fuzzing.scenes import kinds

    moving = ScenePlayer(kinds()["moving camera"])
    list(write_usd(tmp_path / "x.usdc", scene_take(moving, "x", range(7))))
    stage = Usd.Stage.Open(str(tmp_path / "x.usdc"))
    (prim,) = [prim for prim in stage.Traverse() if prim.GetTypeName() == "Camera"]
    for frame in (0, 6):
        to_world = np.array(UsdGeom.Camera(prim).GetLocalTransformation(frame + 1)).T
        np.testing.assert_allclose(to_world[:3, 3], moving.header.cameras[frame].center, atol=1e-6)


def test_sound_is_named_beside_the_file(scene: ScenePlayer, tmp_path: Path) -> None:
    take = scene_take(scene, "x", range(2, 5))
    list(write_usd(tmp_path / "x.usdc", replace(take, sound=Sound(tmp_path / "films" / "cam.mp4", 0.5))))
    stage = Usd.Stage.Open(str(tmp_path / "x.usdc"))
    prim = stage.GetPrimAtPath("/x/Sound")
    assert prim.GetAttribute("filePath").Get().path == "films/cam.mp4"
    assert (prim.GetAttribute("startTime").Get(), prim.GetAttribute("mediaOffset").Get()) == (3, 0.5)


def test_an_export_that_ends_early_leaves_nothing(scene: ScenePlayer, tmp_path: Path) -> None:
    (tmp_path / "x.usdc").write_bytes(b"before")
    steps = write_usd(tmp_path / "x.usdc", scene_take(scene, "x", range(7)))
    next(steps)
    steps.close()
    assert (tmp_path / "x.usdc").read_bytes() == b"before" and len(list(tmp_path.iterdir())) == 2
    refused(r"expected \.usdc", list, write_usd(tmp_path / "x.obj", scene_take(scene, "x", range(7))))
    (tmp_path / "file").write_text("in the way")
    refused("could not be written", list, write_usd(tmp_path / "file" / "x.usdc", scene_take(scene, "x", range(7))))


def test_there_and_back_by_the_commands(scene: ScenePlayer, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.usdc"
    assert main(["export", str(tmp_path / "x.frog"), "--usd", "--out", str(out), "--float"]) == 0
    assert "It plays as filmed at 24 frames a second: set the rate" in capsys.readouterr().out
    assert main(["import", str(out), "--out", str(tmp_path / "back.frog")]) == 0
    assert "40 Gaussians, 7 frames" in capsys.readouterr().out
    back = ScenePlayer.load(tmp_path / "back.frog")
    assert (back.num_dynamic, back.count, back.header.frames_per_second) == (25, 40, 24)
    assert_plays_alike(back, scene.at_frame, FRAMES, 1e-5)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no names of any bytes")
def test_names_that_are_no_text(scene: ScenePlayer, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = os.fsdecode(b"sc\xff\nene")
    folder, named = tmp_path / name, (tmp_path / "x.frog").rename(tmp_path / f"{name}.frog")
    folder.mkdir()
    for kind, ending in ((["--html"], ".html"), (["--usd"], ".usda"), ([], "frames")):
        out = tmp_path / f"{name}{ending}"
        assert main(["export", str(named), *kind, "--out", str(out), "--frames", "0:1"]) == 0
        assert main(["import", str(out), "--out", str(folder / "x.frog")]) == (1 if kind else 0)
    said = capsys.readouterr().err
    assert "ene.usda: found a name that is not UTF-8" in said and "Traceback" not in said
    assert main(["export", str(named), "--usd", "--out", str(folder / "x.usda")]) == 1
    assert "found a name that is not UTF-8" in capsys.readouterr().err and not list(folder.glob("*usd*"))


def authored(path: Path, counts: tuple[int, ...] = (3, 3)) -> Usd.Stage:
    """Another program's: two prims, one of them placed, with samples at 10 and 14 and half colours of degree 1."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetTimeCodesPerSecond(48)
    UsdGeom.Xform.Define(stage, "/a")
    still = SCHEMA.Define(stage, "/a/still")
    still.CreatePositionsAttr(Vt.Vec3fArray([Gf.Vec3f(1, 2, 3)]))
    still.CreateScalesAttr(Vt.Vec3fArray([Gf.Vec3f(0.1, 0.2, 0.3)]))
    moving = SCHEMA.Define(stage, "/a/moving")
    UsdGeom.Xformable(moving).AddTranslateOp().Set(Gf.Vec3d(0, 0, 5))
    UsdGeom.Xformable(moving).AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
    for code, count in zip((10, 14), counts, strict=True):
        moving.CreatePositionsAttr().Set(Vt.Vec3fArray([Gf.Vec3f(code, i, 0) for i in range(count)]), code)
        moving.CreateScaleshAttr().Set(Vt.Vec3hArray([Gf.Vec3h(0.5)] * count), code)
        moving.CreateOpacitiesAttr().Set(Vt.FloatArray([0.5] * count), code)
        colors = Vt.Vec3hArray([Gf.Vec3h(0.1 * i) for i in range(4 * count)])
        moving.CreateRadianceSphericalHarmonicsCoefficientshAttr().Set(colors, code)
    stage.GetRootLayer().Save()
    return stage


def test_anybodys_file_plays_between_its_samples(tmp_path: Path) -> None:
    authored(tmp_path / "x.usda")
    imported = import_scene(tmp_path / "x.usda", tmp_path / "x.frog")
    assert (imported.gaussians, imported.frames, imported.keeps_identity, imported.warning) == (4, 2, True, "")
    back = ScenePlayer.load(imported.path)
    assert (back.header.frames_per_second, back.num_dynamic, back.sh_degree) == (12, 3, 1)
    half_way = back.at_frame(0.5)
    rows = np.argsort(half_way.means[:, 0])
    np.testing.assert_allclose(half_way.means[rows], [[1, 2, 3], [24, 0, 5], [24, 2, 5], [24, 4, 5]], atol=1e-4)
    np.testing.assert_allclose(half_way.scales[rows[1]], 1.0, atol=1e-3)  # doubled by its place
    np.testing.assert_allclose(half_way.opacities[rows], [1, 0.5, 0.5, 0.5], atol=1e-6)
    np.testing.assert_allclose(half_way.sh[rows[0]], 0, atol=1e-7)
    np.testing.assert_allclose(np.sort(half_way.sh[:, 1, 0]), [0, 0.1, 0.5, 0.9], atol=1e-3)


def marked(path: Path, names: str) -> tuple[Usd.Stage, list[UsdGeom.Imageable]]:
    """A stage with prims of one Gaussian each, at x = 0, 1, 2 and so on."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    prims = []
    for x, name in enumerate(names.split()):
        prims.append(SCHEMA.Define(stage, name))
        prims[-1].CreatePositionsAttr(Vt.Vec3fArray([Gf.Vec3f(x, 0, 0)]))
        prims[-1].CreateScalesAttr(Vt.Vec3fArray([Gf.Vec3f(0.1)]))
    return stage, [UsdGeom.Imageable(prim) for prim in prims]


def test_what_a_renderer_shows_is_imported(tmp_path: Path) -> None:
    """A prim that other things are related to, and one for renders; none that is hidden, a stand-in or a prototype."""
    stage, prims = marked(tmp_path / "x.usda", "/a /hidden/b /c /d /copies/e /f /g")
    UsdGeom.Xform.Define(stage, "/hidden").MakeInvisible()
    for prim, purpose in zip(prims[2:4], ("guide", "proxy"), strict=True):
        prim.CreatePurposeAttr(purpose)
    copies = UsdGeom.PointInstancer.Define(stage, "/copies")
    copies.CreatePrototypesRel().AddTarget("/copies/e")
    prims[5].CreatePurposeAttr("render")
    prims[6].GetPrim().GetAttribute("positions").Set(Vt.Vec3fArray())
    stage.GetRootLayer().Save()
    source = open_source(tmp_path / "x.usda")
    assert source.at(0).means[:, 0].tolist() == [0, 5] and source.notes[0].startswith("5 of its 7 prims are left out")
    for index in (0, 5):
        prims[index].MakeInvisible()
    stage.GetRootLayer().Save()
    refused("7 such prims, which are left out: they are invisible", open_source, tmp_path / "x.usda")


def test_a_prim_that_is_hidden_for_a_while_is_not_seen_then(tmp_path: Path) -> None:
    """In a file of centimetres, whose places become metres."""
    stage, _ = marked(tmp_path / "x.usda", "/a /b/c")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    seen = UsdGeom.Xform.Define(stage, "/b").CreateVisibilityAttr()
    for code, word in ((1, "inherited"), (2, "invisible"), (4, "inherited")):
        seen.Set(word, code)
    stage.GetRootLayer().Save()
    source = open_source(tmp_path / "x.usda")
    frames = [source.at(frame) for frame in range(4)]
    assert [frame.opacities.tolist() for frame in frames] == [[1, 1], [1, 0], [1, 0], [1, 1]]
    np.testing.assert_allclose(frames[0].means, [[0, 0, 0], [0.01, 0, 0]], rtol=1e-6)
    np.testing.assert_allclose(frames[0].scales, 0.001, rtol=1e-6)
    assert source.keeps_identity and source.notes == ("Its unit is 0.01 m; places and sizes are in metres now.",)


def test_varying_counts_play_without_anything_between(tmp_path: Path) -> None:
    authored(tmp_path / "x.usda", counts=(3, 5))
    imported = import_scene(tmp_path / "x.usda", tmp_path / "x.frog")
    assert (imported.gaussians, imported.keeps_identity) == (6, False)
    assert "edited by place alone" in imported.warning
    back = ScenePlayer.load(imported.path)
    seen = [int((back.at_frame(frame).opacities > 0).sum()) for frame in (0, 0.9, 1)]
    assert seen == [4, 4, 6]


def test_a_sheared_prim_is_refused(tmp_path: Path) -> None:
    stage = authored(tmp_path / "x.usda")
    UsdGeom.Xformable(stage.GetPrimAtPath("/a")).AddScaleOp().Set(Gf.Vec3f(1, 2, 1))
    stage.GetRootLayer().Save()
    refused(r"x\.usda: /a/(still|moving): .*scaled unevenly", import_scene, tmp_path / "x.usda", tmp_path / "x.frog")
    assert not (tmp_path / "x.frog").exists()


HIDDEN = [
    'def "a" (references = @//server/share/x.usda@)\n{\n}',
    'def "a" (payload = @//server/share/x.usda@)\n{\n}',
    'def "a" (variantSets = "v")\n{\n variantSet "v" = {\n "b" (references = @//server/share/x.usda@)\n {\n }\n }\n}',
    'def "a" (clips = {dictionary d = {string templateAssetPath = "//server/share/x.#.usda"}})\n{\n}',
    'def "a" (clips = {dictionary d = {asset[] assetPaths = [@//server/share/x.usda@]}})\n{\n}',
    'def "a"\n{\n asset[] x.timeSamples = {1: [@//server/share/x.png@]}\n}',
    'def "a" (customData = {asset x = @//server/share/x.png@})\n{\n}',
    'def "a" (references = @`"${X}"`@)\n{\n}',
    "(\n subLayers = [@//server/share/x.usda@]\n)",
]
"""What calls another computer, in a file that the opened one is composed of."""


def test_files_that_cannot_be_used_are_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "text.usda").write_text("#usda 1.0\nnonsense")
    (tmp_path / "none.usda").write_text("#usda 1.0\n")
    single = 'def ParticleField3DGaussianSplat "a"\n{\n point3f[] positions = [(0, 0, 0)]\n float opacities = 1\n}\n'
    (tmp_path / "single.usda").write_text(f"#usda 1.0\n{single}")
    layer = Sdf.Layer.CreateNew(str(tmp_path / "calls.usda"))
    layer.subLayerPaths.append("//server/share/x.usda")
    layer.Save()
    for index, hidden in enumerate(HIDDEN):
        (tmp_path / f"deep{index}.usda").write_text(f"#usda 1.0\n{hidden}\n")
        (tmp_path / f"hidden{index}.usda").write_text(f"#usda 1.0\n(\n subLayers = [@./deep{index}.usda@]\n)\n")
    stage = authored(tmp_path / "lengths.usda")
    stage.GetPrimAtPath("/a/moving").GetAttribute("opacities").Set(Vt.FloatArray([1]), 10)
    stage.GetRootLayer().Save()
    for name, sentence in (
        ("text", "cannot read"),
        ("single", "opacities of another type"),
        ("none", "found 0 such prims"),
        ("calls", "a reference to //server/share"),
        ("lengths", "3 positions and 1 opacities"),
        ("missing", "found no file"),
        *((f"hidden{index}", "a reference to (//server/share|`)") for index in range(len(HIDDEN))),
    ):
        refused(sentence, lambda path=tmp_path / f"{name}.usda": open_source(path).at(0))


def test_a_file_of_text_takes_many_times_its_size(tmp_path: Path) -> None:
    """USD's reader does; the limit that a child has allows for it."""
    count = 18_000
    stage = Usd.Stage.CreateNew(str(tmp_path / "x.usda"))
    splats, numbers = SCHEMA.Define(stage, "/a"), np.random.default_rng(0).normal(size=(16 * count, 3)).astype("f4")
    splats.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(numbers[:count]))
    splats.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(np.abs(numbers[:count]) + 0.1))
    splats.CreateRadianceSphericalHarmonicsCoefficientsAttr(Vt.Vec3fArray.FromNumpy(numbers))
    stage.GetRootLayer().Save()
    assert (tmp_path / "x.usda").stat().st_size > 10**7
    assert import_scene(tmp_path / "x.usda", tmp_path / "x.frog").gaussians == count


def test_a_process_that_ends_is_one_sentence(scene: ScenePlayer, tmp_path: Path) -> None:
    """Lengths in the middle of a crate file are taken at their word by USD's library."""
    content = bytearray(written(scene, tmp_path / "x.usdc").read_bytes())
    refused = 0
    for start in range(len(content) // 2, len(content) - 64, len(content) // 5):
        damaged = content[:start] + b"\xff" * 48 + content[start + 48 :]
        (tmp_path / "bad.usdc").write_bytes(damaged)
        try:
            import_scene(tmp_path / "bad.usdc", tmp_path / "bad.frog")
        except FrogError as error:
            refused += 1
            assert "bad.usdc" in str(error) and "\n" not in str(error)
    assert refused


def test_what_was_placed_is_written_as_the_roots_transform(scene: ScenePlayer, tmp_path: Path) -> None:
    matrix = np.array([[0, -2, 0, 1], [2, 0, 0, 2], [0, 0, 2, 3], [0, 0, 0, 1.0]])

    take = scene_take(scene, "x", range(7))
    placed = replace(take, frames=lambda: (replace(frame, placement=matrix) for frame in take.frames()))
    list(write_usd(tmp_path / "x.usdc", placed, full_precision=True))
    back = ScenePlayer.load(import_scene(tmp_path / "x.usdc", tmp_path / "back.frog").path)
    assert_plays_alike(back, lambda frame: transform(scene.at_frame(frame), matrix), [0, 4], 2e-5)
