"""What other programs write, by a name for it: the layout that is recognised, the writer, and the files to damage."""

from collections.abc import Callable
from pathlib import Path

from support.layouts import rigs

from frog_blender.engine.capture.camera import Camera

Writer = Callable[[Path], list[Camera]]
STANDING: dict[str, tuple[str, Writer, tuple[str, ...]]] = {
    "n3dv_frames": ("n3dv", rigs.n3dv_frames, ("poses_bounds.npy",)),
    "multipleview": ("multipleview", rigs.multipleview, ("sparse_/images.bin", "sparse_/cameras.bin")),
    "multipleview_rows": ("multipleview", rigs.multipleview_rows, ("poses_bounds_multipleview.npy",)),
    "panoptic_sports": (
        "panoptic_sports",
        rigs.panoptic_sports,
        ("train_meta.json", "test_meta.json", "init_pt_cld.npz"),
    ),
    "easyvolcap": ("easyvolcap", rigs.easyvolcap, ("intri.yml", "extri.yml")),
    "easymocap": ("easyvolcap", rigs.easymocap, ("intri.yml", "extri.yml")),
    "caliscope": ("calibration_toml", rigs.caliscope, ("camera_array.toml",)),
    "opencv_frames": ("calibrated_videos", rigs.opencv_frames, ("cameras_opencv.json",)),
    "technicolor": ("technicolor", rigs.technicolor, ("cameras_parameters.txt",)),
}
FISHEYES = {
    "fisheye_toml": ("calibration_toml", rigs.fisheye_toml, ("calibration.toml",)),
    "immersive": ("immersive", rigs.immersive, ("models.json",)),
}
