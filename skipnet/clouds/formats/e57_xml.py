"""What E57 files say of themselves in XML is looked at before a library reads it."""

from __future__ import annotations

import os
import re
import struct
from pathlib import Path

_CRC_BYTES, _DEEPEST, _LARGEST_XML = 4, 64, 1 << 26


def check_xml(path: Path) -> None:
    """Refuse what is no E57 file, is shorter than it says, or nests deeper than any scanner's."""
    size = os.path.getsize(path)
    with open(path, "rb") as file:
        head = file.read(48)
        if head[:8] != b"ASTM-E57" or len(head) < 48:
            raise ValueError(f"{path}: truncated or not an E57 file")
        length, xml_at, xml_bytes, page = struct.unpack_from("<QQQQ", head, 16)
        fits = length <= size and xml_at + xml_bytes <= size and page == 1024
        if not fits or xml_bytes > _LARGEST_XML:
            raise ValueError(f"{path}: truncated or not an E57 file: it is {size} bytes long")
        file.seek(xml_at)
        pages = xml_bytes // (page - _CRC_BYTES) + 2
        body = file.read(pages * page)
    xml = _without_checksums(body, xml_at % page, page)[:xml_bytes]
    depth = deepest = 0
    for tag in re.finditer(rb"<!\[CDATA\[.*?\]\]>|<(/?)[^<>?!][^<>]*?(/?)>", xml, re.DOTALL):
        if tag[1] is None or tag[2]:
            continue
        depth += -1 if tag[1] else 1
        deepest = max(deepest, depth)
    if deepest > _DEEPEST:
        raise ValueError(f"{path}: damaged: its XML nests {deepest} deep")


def _without_checksums(body: bytes, into_page: int, page: int) -> bytes:
    first = page - into_page
    pieces = [body[:first], *(body[at : at + page] for at in range(first, len(body), page))]
    return b"".join(piece[:-_CRC_BYTES] if len(piece) >= _CRC_BYTES else b"" for piece in pieces)
