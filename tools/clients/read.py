"""Reads a file with another program's Python package, which writes what it read as a plain 3DGS ``.ply``. Fourdgs has
no such writer: its arrays are saved as ``.npz``.

    python read.py PACKAGE FILE OUT

Runs in the environment of tools/clients/requirements.txt, where nothing of ours is installed.
"""

import sys
from pathlib import Path


def by_gsply(file: Path, out: Path) -> None:
    import gsply
    from gsply.sog_reader import sogread

    read = {".spz": gsply.read_spz, ".sog": sogread}.get(file.suffix, gsply.plyread)
    gsply.plywrite(out, read(file))


def by_gaussforge(file: Path, out: Path) -> None:
    import gaussforge

    kind = "compressed.ply" if file.name.endswith(".compressed.ply") else file.suffix[1:]
    result = gaussforge.GaussForge().convert(file.read_bytes(), kind, "ply")
    if "error" in result:
        raise SystemExit(result["error"])
    out.write_bytes(result["data"])


def by_fourdgs(file: Path, out: Path) -> None:
    import fourdgs
    import numpy as np
    from fourdgs.quantization import SH_QUANT_HI, SH_QUANT_LO

    if file.suffix == ".ply":
        g, _ = fourdgs.from_compressed_ply([str(file)])
    else:
        g = {".glb": fourdgs.from_gltf, ".usdc": fourdgs.from_usd}[file.suffix](str(file)).gaussians
    sh = (g.colors[:, None, :3] - 0.5) / 0.28209479177387814
    if g.sh is not None:  # bytes, one channel after the other, each with a place for the colour
        whole = g.sh.reshape(len(sh), 3, -1).transpose(0, 2, 1) / 255 * (SH_QUANT_HI - SH_QUANT_LO) + SH_QUANT_LO
        sh = np.concatenate([sh, whole], axis=1)
    turns = np.roll(g.rotations, 1, axis=1)
    np.savez(out, means=g.positions, quaternions=turns, scales=g.scales, opacities=g.colors[:, 3], sh=sh)


if __name__ == "__main__":
    packages = {"gsply": by_gsply, "gaussforge": by_gaussforge, "fourdgs": by_fourdgs}
    packages[sys.argv[1]](Path(sys.argv[2]), Path(sys.argv[3]))
