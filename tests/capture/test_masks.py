"""Masks in every layout, alpha, chroma keys, what the frame store keeps of them, the visual hull, and damaged ones."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support import synthetic_capture as film
from support.builders import refused
from support.filmed_scene import image, moving
from support.layouts.lists import posed_as, write_listed
from support.masked_capture import ball_alpha, write_masks

from frog_blender.engine.capture.capture import Capture, mask_lines
from frog_blender.engine.capture.frame_keys import decoding_key, sources_of
from frog_blender.engine.capture.hull import VisualHull
from frog_blender.engine.capture.masking import ChromaKey, MaskSettings, chroma_key, recolored
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.seeds import SeedSettings, find_seeds
from frog_blender.engine.errors import FrogError
from frog_blender.engine.frames.store import FrameStore

from .readers.reading import refuses

BALL = np.array([-0.9 + 1.8 * 2 / (film.FRAMES - 1), 0.4 * np.sin(2), -0.3])  # its centre at frame 2


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return film.write_capture(tmp_path / "film")


def stored(capture: Capture, tmp_path: Path) -> FrameStore:
    return FrameStore.open(capture, cache_folder=tmp_path / "cache")


def difference(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.abs(first.astype(float) - second).mean())


@pytest.mark.parametrize("layout", ["numbered from one", "film"])
def test_masks_of_a_film_are_read_in_every_layout(folder: Path, tmp_path: Path, layout: str) -> None:
    write_masks(folder / "masks", layout)
    capture = open_capture(folder)
    store = stored(capture, tmp_path)
    for index, shot in enumerate(capture.shots):
        truth = ball_alpha(capture.cameras[shot.camera], shot.frame)
        alpha = store.alpha(index)
        assert alpha is not None and difference(alpha, truth) < (2.5 if layout == "film" else 0.01)
        assert store.image(index)[alpha == 0].max(initial=0) == 0 and store.ignored(index) is None
    assert mask_lines(capture) == [f"only this: masks of 4 cameras, {film.FRAMES} frames each"]


def test_one_mask_serves_all_frames_and_an_ignore_mask_leaves_the_image_as_it_is(folder: Path, tmp_path: Path) -> None:
    plain = stored(open_capture(folder), tmp_path)
    (folder / "ignore").mkdir()
    mark = np.zeros((film.HEIGHT, film.WIDTH), np.uint8)
    mark[3:9, 5:12] = 255
    cv2.imwrite(str(folder / "ignore" / "cam02.png"), mark)
    capture = open_capture(folder)
    store = stored(capture, tmp_path)
    for index, shot in enumerate(capture.shots):
        ignored, name = store.ignored(index), capture.cameras[shot.camera].name
        assert store.alpha(index) is None
        np.testing.assert_array_equal(ignored, mark if name == "cam02" else 0 * mark)
        np.testing.assert_array_equal(store.image(index), plain.image(index))
    assert mask_lines(capture) == [f"ignored: masks of 1 camera, {film.FRAMES} frames each"]


def test_without_masks_everything_is_as_before(folder: Path, tmp_path: Path) -> None:
    def key(capture: Capture) -> str:
        return decoding_key(capture, sources_of(capture))

    before = key(open_capture(folder))
    write_masks(folder / "masks", "numbered")
    assert key(open_capture(folder)) != before
    capture = open_capture(folder, masks=MaskSettings(use=False))
    assert key(capture) == before and not capture.has_masks
    assert stored(capture, tmp_path).alpha(0) is None
    assert open_capture(folder).segment(1, 2).without_cameras(["cam01"]).shots[0].mask is not None


def posed_images(folder: Path, alpha: Callable[[int], np.ndarray] | None = None, **first: object) -> Path:
    """Images with ``transforms.json``, of a camera that moves; ``first`` is said of the first one."""
    (folder / "images").mkdir(parents=True)
    frames = []
    for number, camera in enumerate(moving()):
        pixels = image(camera, number)[:, :, ::-1]
        if alpha is not None:
            pixels = np.dstack([pixels, alpha(number)])
        cv2.imwrite(str(folder / "images" / f"view_{number}.png"), pixels)
        frames.append(posed_as(camera, f"images/view_{number}.png", time=number, **first if number == 0 else {}))
    write_listed(folder, [], frames, fl_x=52.0, fl_y=54.0, cx=33.5, cy=22.25, w=64, h=48)
    return folder


def half(_number: int) -> np.ndarray:
    alpha = np.zeros((48, 64), np.uint8)
    alpha[:, 20:] = 255
    alpha[:, 19] = 100
    return alpha


def test_images_with_alpha_are_masks_by_themselves(tmp_path: Path) -> None:
    capture = open_capture(posed_images(tmp_path / "rgba", half))
    store = stored(capture, tmp_path)
    np.testing.assert_array_equal(store.alpha(2), half(2))
    assert store.image(2)[:, :19].max() == 0 and mask_lines(capture) == ["only this: alpha of 5 images"]
    whole = stored(replace(capture, background=(1.0, 1.0, 1.0)), tmp_path)
    again = recolored(whole.image(2), half(2), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    assert np.abs(again.astype(int) - store.image(2)).max() <= 1


def listed_masks(folder: Path, name: str) -> Path:
    """``posed_images``, the first of which has a mask whose left part is black."""
    posed_images(folder, mask_path=name)
    cv2.imwrite(str(folder / "black.png"), np.where(half(0) > 127, np.uint8(255), np.uint8(0)))
    return folder


def test_what_is_black_in_a_mask_that_transforms_json_names_is_ignored(tmp_path: Path) -> None:
    folder = listed_masks(tmp_path / "listed", "./black.png")
    capture = open_capture(folder)
    store = stored(capture, tmp_path)
    first = next(index for index, shot in enumerate(capture.shots) if shot.ignore is not None)
    ignored = store.ignored(first)
    assert ignored is not None and ignored[:, :20].all() and not ignored[:, 20:].any()
    assert all(not store.ignored(index).any() for index in range(len(capture.shots)) if index != first)
    assert store.alpha(first) is None and mask_lines(capture) == ["ignored: masks of 1 images"]
    assert not open_capture(folder, masks=MaskSettings(use=False)).has_masks


@pytest.mark.parametrize("name", ["../black.png", 7, "", "a\0b"])
def test_masks_that_transforms_json_names_are_checked(tmp_path: Path, name: str) -> None:
    refuses(listed_masks(tmp_path / "listed", name), "mask")


@pytest.mark.parametrize("name", ["images/view_{}.png", "view_{}.png", "images/view_{}.png.png"])
def test_masks_of_images_have_their_names(tmp_path: Path, name: str) -> None:
    folder = posed_images(tmp_path / "posed")
    for number in range(5):
        path = folder / "masks" / name.format(number)
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), half(number))
    np.testing.assert_array_equal(stored(open_capture(folder), tmp_path).alpha(4), half(4))


def damaged(folder: Path, what: str) -> str:
    """Damages the masks of a folder; returns what is to be said."""
    masks = folder / "masks"
    write_masks(masks, "numbered")
    if what == "size":
        cv2.imwrite(str(masks / "cam01" / "0000.png"), np.zeros((10, 10), np.uint8))
        return f"found a mask of 10 x 10 pixels, expected {film.WIDTH} x {film.HEIGHT} pixels"
    if what == "gap":
        (masks / "cam01" / "0003.png").unlink()
        return "1 of 6 masks are missing .number 3., expected one for each frame"
    for path in (masks / "cam02").iterdir():
        path.unlink()
    return "found no mask for 6 of 24 images .cam02 at frame 0.*, expected one for each image, or none"


@pytest.mark.parametrize("what", ["size", "gap", "camera"])
def test_damaged_masks_are_one_sentence(folder: Path, what: str) -> None:
    said = damaged(folder, what)
    refuses(folder, said)


def test_a_later_mask_of_another_size_and_one_that_is_no_image_are_one_sentence(folder: Path, tmp_path: Path) -> None:
    write_masks(folder / "masks", "numbered")
    late = folder / "masks" / "cam03" / "0004.png"
    cv2.imwrite(str(late), np.zeros((10, 10), np.uint8))
    refused(r"0004\.png: found a mask of 10 x 10 pixels, expected", stored, open_capture(folder), tmp_path)
    late.write_bytes(b"no image")
    with pytest.raises(FrogError, match=r"0004\.png: found a file that cannot be decoded, expected an image"):
        stored(open_capture(folder), tmp_path)


def test_masks_of_nothing_are_warned_of(folder: Path) -> None:
    (folder / "masks").mkdir()
    cv2.imwrite(str(folder / "masks" / "someone.png"), np.zeros((10, 10), np.uint8))
    capture = open_capture(folder)
    assert not capture.has_masks and "none of the masks has the name of a camera" in capture.warnings[-1]


def test_a_chroma_key_takes_the_backdrop_and_its_light_off() -> None:
    key = chroma_key("green")
    green = np.array(key.color, float)
    skin = np.array([200.0, 150, 120])
    shares = [0.0, 0.5, 1.0]  # of the backdrop
    image = np.array([[skin * (1 - s) + green * s for s in shares] + [green * 0.7, [30, 30, 30]]]).round()
    subject, alpha = key.apply(image.astype(np.uint8))
    assert alpha[0, 0] == 255 and alpha[0, 2] == 0 and alpha[0, 3] == 0 and alpha[0, 4] == 255
    assert 20 < alpha[0, 1] < 160  # a soft edge
    np.testing.assert_allclose(subject[0, 0], skin, atol=2)
    red, middle, _ = subject[0, 1].astype(int)
    assert middle <= red  # nothing green is left of the edge


def test_keys_are_read_and_refused() -> None:
    assert chroma_key("#0047bb,0.2") == chroma_key("blue,0.2") == ChromaKey((0, 71, 187), 0.2)
    assert chroma_key(str(chroma_key("green,0.3"))) == chroma_key("green,0.3")
    for text in ("", "greenish", "#12", "green,x", "green,1.5", "green,nan"):
        refused(r"The key is .*, expected green, blue or a colour", chroma_key, text)
    refused("is grey", chroma_key, "#808080")


def test_a_key_is_a_mask_of_every_image(folder: Path, tmp_path: Path) -> None:
    capture = open_capture(folder, masks=MaskSettings(key="#ffb000,0.3"))  # about the ball's colour
    store = stored(capture, tmp_path)
    alpha = store.alpha(0)
    assert alpha is not None and alpha.min() < 160 and (alpha == 255).mean() > 0.5
    assert mask_lines(capture) == ["only this: what is not #ffb000,0.3"]


def test_the_hull_of_a_subject_holds_it_its_seeds_and_nothing_else(folder: Path, tmp_path: Path) -> None:
    write_masks(folder / "masks", "numbered")
    capture = open_capture(folder)
    store = stored(capture, tmp_path)
    hull = VisualHull(capture, store, capture.train_indices)
    behind = np.array([[0.0, 0.0, 1.2], [-2.0, 1.0, 1.0], [0.0, 0.0, -60.0]])  # the wall, and nowhere
    points = np.concatenate([BALL[None], behind])
    inside, seen = hull.contains_at(points, 2)
    assert inside.tolist() == [True, False, False, False] and (seen[:2] > 0).all()
    assert hull.contains(points).tolist() == [True, False, False, False]
    assert not hull.contains_at(points, 5)[0].any()  # the ball is elsewhere by then
    seeds = find_seeds(capture, store, SeedSettings(400))
    assert len(seeds.points) > 50
    assert hull.contains(seeds.points.astype(float)).mean() > 0.95  # seeding looks at fewer frames
    assert seeds.points[:, 2].max() < 1.0  # not on the wall
