"""How tiles of decoded frames are compressed: by Zstandard, whose checksum finds what is not what was packed."""

import threading
from typing import Any

from ..optional_imports import importing

_SHORTEST_MATCH = 7  # bytes: shorter ones cost more time than they save space
_WINDOW_BITS = 16  # a tile has less than 2**16 bytes
_HASH_BITS = 6  # as good as none: repetitions are rare, and nearly all is gained by each byte's code length


class TileCodec(threading.local):
    """Used by any number of threads: each has a compressor of its own.

    Raises:
        FrogError: without the package ``zstandard``.
    """

    def __init__(self) -> None:
        with importing("zstandard", "Decoded frames need zstandard: pip install zstandard."):
            import zstandard
        self._library: Any = zstandard  # of a package that not everybody has
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
        self._compressor = self._library.ZstdCompressor(compression_params=parameters)
        self._decompressor = self._library.ZstdDecompressor()

    def pack(self, numbers: memoryview) -> bytes:
        """Compresses bytes."""
        return bytes(self._compressor.compress(numbers))

    def unpack(self, packed: memoryview, size: int) -> bytes:
        """The bytes, so many, that were packed; ValueError if they are others."""
        try:
            if self._library.frame_content_size(packed) != size:
                raise ValueError("a tile of another size")
            content: bytes = self._decompressor.decompress(packed)
        except self._library.ZstdError as error:
            raise ValueError(str(error)) from error
        return content
