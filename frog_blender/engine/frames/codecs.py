"""How tiles of decoded frames are compressed: by Zstandard where its package is installed, else by zlib.

Both add a checksum, and find what is not what was packed. Zlib unpacks at a third of the speed; Python always has it.
"""

from __future__ import annotations

import threading
import zlib
from typing import Any, Protocol

_SHORTEST_MATCH = 7  # bytes: shorter ones cost more time than they save space
_WINDOW_BITS = 16  # a tile has less than 2**16 bytes
_HASH_BITS = 6  # as good as none: repetitions are rare, and nearly all is gained by each byte's code length


class TileCodec(Protocol):
    """Used by any number of threads.

    Attributes:
        name: what an index calls it.
    """

    name: str

    def pack(self, numbers: memoryview) -> bytes:
        """Compresses bytes."""
        ...

    def unpack(self, packed: memoryview, size: int) -> bytes:
        """The ``size`` bytes that were packed. ValueError if they are others."""
        ...


class Zstandard:
    """The package ``zstandard``. ImportError where it is missing."""

    name = "zstandard"

    def __init__(self) -> None:
        import zstandard

        self._library: Any = zstandard  # of a package that not everybody has
        self._of_thread = threading.local()  # a compressor or decompressor serves one thread at a time

    def pack(self, numbers: memoryview) -> bytes:
        """See TileCodec."""
        compressor = getattr(self._of_thread, "compressor", None)
        if compressor is None:
            compressor = self._of_thread.compressor = self._compressor()
        packed: bytes = compressor.compress(numbers)
        return packed

    def unpack(self, packed: memoryview, size: int) -> bytes:
        """See TileCodec."""
        decompressor = getattr(self._of_thread, "decompressor", None)
        if decompressor is None:
            decompressor = self._of_thread.decompressor = self._library.ZstdDecompressor()
        try:
            if self._library.frame_content_size(packed) != size:
                raise ValueError("a tile of another size")
            content: bytes = decompressor.decompress(packed)
        except self._library.ZstdError as error:
            raise ValueError(str(error)) from error
        return content

    def _compressor(self) -> Any:
        parameters = self._library.ZstdCompressionParameters(
            strategy=self._library.STRATEGY_FAST,
            window_log=_WINDOW_BITS,
            hash_log=_HASH_BITS,
            chain_log=_HASH_BITS,
            search_log=1,
            min_match=_SHORTEST_MATCH,
            target_length=0,
            write_checksum=True,
        )
        return self._library.ZstdCompressor(compression_params=parameters)


class Zlib:
    """Of Python itself. Runs of equal bytes alone are looked for: that packs these numbers best, and soonest."""

    name = "zlib"

    def pack(self, numbers: memoryview) -> bytes:
        """See TileCodec."""
        compressor = zlib.compressobj(1, strategy=zlib.Z_RLE)
        return compressor.compress(numbers) + compressor.flush()

    def unpack(self, packed: memoryview, size: int) -> bytes:
        """See TileCodec."""
        decompressor = zlib.decompressobj()
        try:
            content = decompressor.decompress(packed, size)
            rest = decompressor.decompress(decompressor.unconsumed_tail, 1)  # in which the checksum may be
        except zlib.error as error:
            raise ValueError(str(error)) from error
        if len(content) != size or rest or not decompressor.eof:
            raise ValueError("a tile of another size")
        return content


def usual_codec() -> TileCodec:
    """What tiles are packed by."""
    try:
        return Zstandard()
    except ImportError:
        return Zlib()


def codec_of(name: object) -> TileCodec | None:
    """The codec that an index names; None where there is no such one, or its package is missing."""
    if name == Zlib.name:
        return Zlib()
    try:
        return Zstandard() if name == Zstandard.name else None
    except ImportError:
        return None
