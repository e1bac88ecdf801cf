"""Compressed pictures that are kept as they are: no second loss, and no time to decode them.

Source: ISO/IEC 10918-1, annex B (JPEG markers); the PNG specification, section 11.2.2.
"""

from __future__ import annotations

import struct

from codediffuser.datagen.episode_format import ImageOptions
from codediffuser.datagen.log_step import StoredPicture

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"IEND\xaeB`\x82"
_JPEG_START, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
_TRUE_COLOR = 2
_NOT_FRAMES = (0xC4, 0xC8, 0xCC)
"""Markers among the frame headers that are tables."""


def stored_picture(data: bytes, options: ImageOptions) -> StoredPicture | None:
    """A picture to keep byte for byte; None when it is of another kind, or not whole.

    Args:
        data: Bytes of a compressed picture; zeros after its end are cut off.
        options: How pictures are to be stored.
    """
    size = None
    if options.format == "jpeg" and data.startswith(_JPEG_START):
        data = data.rstrip(b"\0")
        size = _jpeg_size(data) if data.endswith(_JPEG_END) else None
    elif options.format == "png" and data.startswith(_PNG):
        data = data.rstrip(b"\0")
        size = _png_size(data) if data.endswith(_PNG_END) else None
    return None if size is None else StoredPicture(data, options.format, *size)


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Height and width of a colour JPEG, from its frame header."""
    position = 2
    while position + 9 < len(data) and data[position] == 0xFF:
        marker = data[position + 1]
        (length,) = struct.unpack_from(">H", data, position + 2)
        if 0xC0 <= marker <= 0xCF and marker not in _NOT_FRAMES:
            bits, height, width, components = struct.unpack_from(">BHHB", data, position + 4)
            return (height, width) if bits == 8 and components == 3 else None
        position += 2 + length
    return None


def _png_size(data: bytes) -> tuple[int, int] | None:
    """Height and width of a PNG with 8-bit colour."""
    width, height, bits, kind = struct.unpack_from(">IIBB", data, 16)
    return (height, width) if bits == 8 and kind == _TRUE_COLOR else None
