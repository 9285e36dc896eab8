"""What a glTF file is made of: its description, and the buffers that it names: its own, in the text, or beside it."""

from __future__ import annotations

import base64
import binascii
import struct
from pathlib import Path
from urllib.parse import unquote

from ..errors import FrogError, brief
from ..io.plain_values import JsonObject, UnfitValue, entries, items, plain_json, text, whole
from ..io.regular_file import regular_file

MAGIC, JSON, BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
HEADER, CHUNK = struct.Struct("<III"), struct.Struct("<II")
_EXPECTED = "a glTF 2.0 file"
_LONGEST_NAME = 1024  # characters of a file beside the description
_LONGEST_JSON, _LARGEST = 64 << 20, 4 << 30  # bytes, of all buffers together as well
_MOST_BUFFERS = 1024
_DATA = ("data:application/octet-stream;base64,", "data:application/gltf-buffer;base64,")


def opened(path: Path, content: bytes) -> tuple[JsonObject, list[memoryview]]:
    """The description and the buffers of a ``.glb`` or a ``.gltf``, whichever the content is.

    A buffer beside the file is read from its own folder or one below, never from another place.

    Raises:
        UnfitValue: for any other content.
        FrogError: for a buffer that is not there.
    """
    own: memoryview | None = None
    if content[:4] == MAGIC.to_bytes(4, "little"):
        told, own = _chunks(content)
    else:
        told = content
    if len(told) > _LONGEST_JSON:
        raise UnfitValue(f"a description of {len(told):,} bytes", f"at most {_LONGEST_JSON:,}")
    try:
        document = entries(plain_json(told.decode("utf-8-sig"), "a description"), "a description")
    except UnicodeDecodeError as error:
        raise UnfitValue("a description that is no text", _EXPECTED) from error
    version = entries(document.get("asset"), "asset").get("version")
    if not str(version).startswith("2."):
        raise UnfitValue(f"version {brief(version)}", _EXPECTED)
    return document, _buffers(path, document, own)


def _chunks(content: bytes) -> tuple[bytes, memoryview | None]:
    """The description and the buffer of a binary file."""
    _, version, size = HEADER.unpack_from(content.ljust(HEADER.size, b"\0"))
    if version != 2 or size > len(content):
        raise UnfitValue("no binary glTF 2.0, or a part of one", _EXPECTED)
    chunks: dict[int, memoryview] = {}
    at, whole_file = HEADER.size, memoryview(content)
    while at + CHUNK.size <= size and len(chunks) < 2:
        length, kind = CHUNK.unpack_from(content, at)
        at += CHUNK.size
        if at + length > size:
            raise UnfitValue(f"a chunk of {length:,} bytes at {at:,} of {size:,}", _EXPECTED)
        chunks[kind] = whole_file[at : at + length]
        at += length
    if JSON not in chunks or len(chunks[JSON]) > _LONGEST_JSON:
        raise UnfitValue("no description", _EXPECTED)
    return bytes(chunks[JSON]), chunks.get(BINARY)


def _buffers(path: Path, document: JsonObject, own: memoryview | None) -> list[memoryview]:
    found: list[memoryview] = []
    files: dict[str, memoryview] = {}  # however often one is named, it is read once
    room = _LARGEST
    for index, item in enumerate(items(document.get("buffers"), "buffers", _MOST_BUFFERS)):
        buffer = entries(item, "a buffer")
        size = whole(buffer.get("byteLength"), "the size of a buffer", 1, _LARGEST)
        if "uri" not in buffer:
            if index or own is None:
                raise UnfitValue("a buffer that is nowhere", _EXPECTED)
            content = own
        else:
            name = text(buffer["uri"], "where a buffer is", _LONGEST_JSON)
            if name not in files:
                files[name] = memoryview(_in_text(name) if name.startswith("data:") else _beside(path, name, room))
                room -= len(files[name])
            content = files[name]
        if len(content) < size:
            raise UnfitValue(f"a buffer of {len(content):,} bytes", f"the {size:,} that are announced")
        found.append(content[:size])
    return found


def _in_text(uri: str) -> bytes:
    start = next((start for start in _DATA if uri.startswith(start)), None)
    if start is None:
        raise UnfitValue(f"a buffer written as {brief(uri[:60])}", "bytes in base64")
    try:
        return base64.b64decode(uri[len(start) :], validate=True)
    except (binascii.Error, ValueError) as error:
        raise UnfitValue("a buffer that is no base64", _EXPECTED) from error


def _beside(path: Path, uri: str, most: int) -> bytes:
    """What a file near the description holds."""
    if len(uri) > _LONGEST_NAME:
        raise UnfitValue(f"a buffer at {brief(uri[:60])}", f"a name of {_LONGEST_NAME:,} characters at most")
    name = unquote(uri)
    parts = name.split("/")
    if ":" in name or "\\" in name or "\0" in name or not name or ".." in parts or name.startswith("/"):
        raise UnfitValue(f"a buffer at {brief(uri)}", "one in the folder of the file")
    place = regular_file(path.parent / name, "a buffer of the glTF file")
    try:
        size = place.stat().st_size
        if size > most:
            raise UnfitValue(f"buffers of more than {_LARGEST:,} bytes", "smaller ones")
        return place.read_bytes()
    except OSError as error:
        raise FrogError(f"{place}: could not be read ({error.strerror or error}).") from error
