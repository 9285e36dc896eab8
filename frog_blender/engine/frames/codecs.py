"""How tiles of decoded frames are compressed: by Zstandard where its package is installed, else by zlib.

Both add a checksum, and find what is not what was packed. Zlib unpacks at a third of the speed; Python always has it.
"""

from __future__ import annotations

import threading
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

_SHORTEST_MATCH = 7  # bytes: shorter ones cost more time than they save space
_WINDOW_BITS = 16  # a tile has less than 2**16 bytes
_HASH_BITS = 6  # as good as none: repetitions are rare, and nearly all is gained by each byte's code length


@dataclass(frozen=True)
class TileCodec:
    """Used by any number of threads.

    Attributes:
        name: what an index calls it.
        pack: compresses bytes.
        unpack: the bytes, so many, that were packed; ValueError if they are others.
    """

    name: str
    pack: Callable[[memoryview], bytes]
    unpack: Callable[[memoryview, int], bytes]


def zstandard_codec() -> TileCodec:
    """The package ``zstandard``. ImportError where it is missing."""
    import zstandard

    library: Any = zstandard  # of a package that not everybody has
    of_thread = threading.local()  # a compressor or decompressor serves one thread at a time

    def pack(numbers: memoryview) -> bytes:
        if not hasattr(of_thread, "compressor"):
            parameters = library.ZstdCompressionParameters(
                strategy=library.STRATEGY_FAST,
                window_log=_WINDOW_BITS,
                hash_log=_HASH_BITS,
                chain_log=_HASH_BITS,
                search_log=1,
                min_match=_SHORTEST_MATCH,
                target_length=0,
                write_checksum=True,
            )
            of_thread.compressor = library.ZstdCompressor(compression_params=parameters)
        packed: bytes = of_thread.compressor.compress(numbers)
        return packed

    def unpack(packed: memoryview, size: int) -> bytes:
        if not hasattr(of_thread, "decompressor"):
            of_thread.decompressor = library.ZstdDecompressor()
        try:
            if library.frame_content_size(packed) != size:
                raise ValueError("a tile of another size")
            content: bytes = of_thread.decompressor.decompress(packed)
        except library.ZstdError as error:
            raise ValueError(str(error)) from error
        return content

    return TileCodec("zstandard", pack, unpack)


def zlib_codec() -> TileCodec:
    """Of Python itself. Runs of equal bytes alone are looked for: that packs these numbers best, and soonest."""

    def pack(numbers: memoryview) -> bytes:
        compressor = zlib.compressobj(1, strategy=zlib.Z_RLE)
        return compressor.compress(numbers) + compressor.flush()

    def unpack(packed: memoryview, size: int) -> bytes:
        decompressor = zlib.decompressobj()
        try:
            content = decompressor.decompress(packed, size)
            rest = decompressor.decompress(decompressor.unconsumed_tail, 1)  # in which the checksum may be
        except zlib.error as error:
            raise ValueError(str(error)) from error
        if len(content) != size or rest or not decompressor.eof:
            raise ValueError("a tile of another size")
        return content

    return TileCodec("zlib", pack, unpack)


def codec_of(name: object) -> TileCodec | None:
    """The codec that an index names; None where there is no such one, or its package is missing."""
    try:
        return zstandard_codec() if name == "zstandard" else zlib_codec() if name == "zlib" else None
    except ImportError:
        return None


def usual_codec() -> TileCodec:
    """What tiles are packed by."""
    return codec_of("zstandard") or zlib_codec()
