"""How much compressed content may become: a small file that unpacks to gigabytes is damaged, or made to fill memory."""

import zipfile
import zlib

from ..errors import brief
from .plain_values import UnfitValue

_ALWAYS, _BYTES_OF_BYTE = 8 << 20, 16
"""Bytes that any file may become, and for each of its own: Gaussians become two to five times as many."""


def check_growth(what: str, packed: int, unpacked: int) -> None:
    """UnfitValue for content whose bytes become far more than those of Gaussians do."""
    most = max(_ALWAYS, _BYTES_OF_BYTE * packed)
    if unpacked > most:
        raise UnfitValue(f"{packed:,} bytes of {what} that become {unpacked:,}", f"at most {most:,}")


def zip_member(archive: zipfile.ZipFile, name: str) -> bytes:
    """What a member of an archive holds; UnfitValue where that is far more than its bytes, KeyError for no member."""
    entry = archive.getinfo(name)
    check_growth(brief(name), entry.compress_size, entry.file_size)
    with archive.open(entry) as packed:
        return packed.read(entry.file_size)


def inflated(content: bytes, size: int, what: str) -> bytes:
    """What zlib compressed, which has to be that many bytes: no more memory is taken. UnfitValue for anything else."""
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(content, size + 1)
    except zlib.error as error:
        raise UnfitValue(f"{what} that is damaged ({error})", "a whole one") from error
    if len(unpacked) != size or not unpacker.eof:
        raise UnfitValue(f"{what} from other than {size:,} bytes", "that many")
    return unpacked
