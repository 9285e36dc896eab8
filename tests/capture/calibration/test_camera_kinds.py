"""Make and model of cameras, as videos and photographs say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.films import encode, numbered, photograph

from frog_blender.engine.capture.calibration.camera_kinds import kind_by, kind_of
from frog_blender.engine.capture.calibration.films import find_films, view_film, with_groups

IMAGE = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)


def frames(folder: Path, name: str, **tags: object) -> Path:
    (folder / name).mkdir(parents=True)
    for number in range(3):
        photograph(folder / name / f"{number:04d}.jpg", IMAGE, **tags)
    return folder / name


@pytest.mark.parametrize(
    ("tags", "kind"),
    [
        ({"com.apple.quicktime.make": "Apple", "com.apple.quicktime.model": "iPhone 13"}, "Apple, iPhone 13"),
        ({"com.android.manufacturer": "Google", "com.android.model": "Pixel 7"}, "Google, Pixel 7"),
        ({"firmware": "HD9.01.01.60.00"}, "HD9"),
        ({"major_brand": "isom", "encoder": "Lavf59.27.100"}, ""),
    ],
)
def test_make_and_model_are_read_from_a_films_tags(tags: dict[str, str], kind: str) -> None:
    assert kind_by(tags) == kind


def test_make_and_model_are_read_from_files(tmp_path: Path) -> None:
    assert kind_of(frames(tmp_path, "cam01", make="Sony", model="ILCE-7M3", focal_length=35)) == "Sony, ILCE-7M3, 35"
    assert kind_of(frames(tmp_path, "cam02")) == ""
    assert kind_of(encode(tmp_path / "a.mkv", numbered(3), tags={"MAKE": "Sony", "MODEL": "A7"})) == "Sony, A7"


def test_frames_of_two_makes_of_one_size_are_of_two_kinds(tmp_path: Path) -> None:
    for name, make in {"a": "Sony", "b": "Canon", "c": "Sony"}.items():
        frames(tmp_path, name, make=make, model="X", focal_length=35)
    films = find_films(tmp_path)
    views = [view_film(film, [], lambda: None) for film in films]
    assert [view.group for view in with_groups(views, kinds=[film.kind for film in films])] == [1, 0, 1]
