from pathlib import Path

import numpy as np
import pytest
from support.small_captures import llff_row, write_n3dv, write_video

from frog_blender.engine.capture.readers import detect, open_capture

from .readers.reading import refuses


def test_rows_belong_to_sorted_names_with_gaps(n3dv: Path) -> None:
    assert detect(n3dv) == "n3dv"
    capture = open_capture(n3dv)
    assert [camera.name for camera in capture.cameras] == ["cam00", "cam01", "cam03"]
    np.testing.assert_allclose([camera.center for camera in capture.cameras], [[0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert capture.test_cameras == {"cam00"}
    assert (capture.frame_count, capture.frames_per_second, capture.near_far) == (5, 30.0, (0.5, 20.0))
    assert not capture.is_moving
    (n3dv / "cam01.mp4").unlink()
    (n3dv / "cam03.mp4").unlink()
    np.save(n3dv / "poses_bounds.npy", llff_row(480, 640, 500.0)[None])
    (camera,) = open_capture(n3dv).cameras
    np.testing.assert_allclose(camera.intrinsics, [[50, 0, 32], [0, 50, 24], [0, 0, 1]])
    assert not open_capture(n3dv).test_cameras  # the only camera cannot be held out


def test_another_number_of_rows_is_refused(n3dv: Path) -> None:
    (n3dv / "cam01.mp4").unlink()
    refuses(n3dv, "3 rows for 2 videos")


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        (np.full((3, 17), np.nan), "row 0 with a value that is not finite"),
        (np.zeros((3, 17)), "zero or less in row 0"),
        (np.ones((3, 17)), "mirrors, scales or shears"),
        (np.ones((3, 15)), "shape \\(3, 15\\)"),
        (np.array(["a"]), "shape \\(1,\\)"),
    ],
)
def test_rows_that_make_no_sense_are_refused(n3dv: Path, rows: np.ndarray, sentence: str) -> None:
    np.save(n3dv / "poses_bounds.npy", rows)
    refuses(n3dv, sentence)


def test_an_empty_video_is_named(n3dv: Path) -> None:
    (n3dv / "cam01.mp4").write_bytes(b"")
    refuses(n3dv, r"cam01\.mp4: found an empty file")
    (n3dv / "cam01.mp4").write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n//server/share/x.ts\n")
    refuses(n3dv, r"cam01\.mp4: found a list of other files")


def test_a_video_that_ends_early_tells_how_much_is_left(tmp_path: Path) -> None:
    folder = write_n3dv(tmp_path, ("cam00",), frames=2)
    noise = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    video = write_video(folder / "cam00.avi", 40, image=lambda frame: noise)
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])  # AVI keeps its header, which says 40
    (folder / "cam00.mp4").unlink()
    refuses(folder, r"cam00\.avi: \d+ frames could be decoded, expected 40")
