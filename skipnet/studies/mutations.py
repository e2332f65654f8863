"""Files made worse, at random but repeatably; checksums are made right again where there are some,
so that what lies behind them is reached."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from functools import cache

import numpy as np

_EXTREMES = [b"\xff" * 4, bytes(4), b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80", b"\xff" * 8]
_EXTREMES += [bytes(8), b"\x01\x00\x00\x00", b"\x00\x00\xc0\x7f", b"\x00\x00\x80\x7f"]
_WORDS = [b"-1", b"99999999999", b"nan", b"1e400", b"\n", b" ", b"#", b",", b"0", b"x", b"2.5"]
_PAGE, _CHECKSUM = 1024, 4


def mutated(files: list[bytes], extension: str, seed: int, number: int) -> bytes:
    """One of the files, changed in one to four places.

    Args:
        files: whole ones of a format.
        extension: of the format.
        seed: of the study.
        number: of the file; the same number and seed make the same file.
    """
    rng = np.random.default_rng([seed, zlib.crc32(extension.encode()), number])
    whole = files[int(rng.integers(len(files)))]
    change = _BEHIND_CHECKSUMS.get(extension)
    if change is not None and rng.random() < 0.7:
        return change(whole, rng)
    return changed(whole, rng)


def changed(content: bytes, rng: np.random.Generator) -> bytes:
    """Bytes replaced, put in, taken out, cut off, repeated, or a number for another."""
    for _ in range(int(rng.integers(1, 5))):
        kind = rng.integers(7)
        at = int(len(content) * rng.random() ** 2)  # headers more often
        piece = _piece(rng)
        if kind == 0:
            content = content[:at] + piece + content[at + len(piece) :]
        elif kind == 1:
            content = content[:at] + piece + content[at:]
        elif kind == 2:
            content = content[:at] + content[at + int(rng.integers(1, 12)) :]
        elif kind == 3 and rng.random() < 0.3:
            content = content[:at]
        elif kind == 4:
            content = content[:at] + content[at // 2 : at // 2 + 64] + content[at:]
        elif kind == 5:
            content = _another_number(content, rng)
        elif content:
            at = min(at, len(content) - 1)
            flipped = content[at] ^ 1 << int(rng.integers(8))
            content = content[:at] + bytes([flipped]) + content[at + 1 :]
    return content


def _piece(rng: np.random.Generator) -> bytes:
    choice = rng.random()
    if choice < 0.4:
        return _EXTREMES[int(rng.integers(len(_EXTREMES)))]
    if choice < 0.7:
        return _WORDS[int(rng.integers(len(_WORDS)))]
    return rng.bytes(int(rng.integers(1, 5)))


def _another_number(content: bytes, rng: np.random.Generator) -> bytes:
    """A number in the text of the file in place of which stands another."""
    numbers = list(re.finditer(rb"\d+", content[: 1 << 14]))
    if not numbers:
        return content
    found = numbers[int(len(numbers) * rng.random())]
    other = str(int(rng.integers(0, 2 ** int(rng.integers(1, 63))))).encode()
    return content[: found.start()] + other + content[found.end() :]


def _in_pages(content: bytes, rng: np.random.Generator) -> bytes:
    """An E57 file changed between its pages' checksums, with its lengths set right."""
    pages = range(0, len(content), _PAGE)
    inside = b"".join(content[at : at + _PAGE - _CHECKSUM] for at in pages)
    split = int.from_bytes(content[24:32], "little")
    start = split // _PAGE * (_PAGE - _CHECKSUM) + split % _PAGE
    length = int.from_bytes(content[32:40], "little")
    if rng.random() < 0.5:  # the XML, or what stands before it
        xml = changed(inside[start : start + length], rng)
        inside, length = inside[:start] + xml, len(xml)
    else:
        head = changed(inside[48:start], rng)[: start - 48].ljust(start - 48, b"\0")
        inside = inside[:48] + head + inside[start : start + length]
    return paged(inside, length)


def paged(inside: bytes, xml_bytes: int) -> bytes:
    """The E57 file of what stands between checksums, with the length of its XML."""
    inside += bytes(-len(inside) % (_PAGE - _CHECKSUM))
    count = len(inside) // (_PAGE - _CHECKSUM)
    head = bytearray(inside)
    struct.pack_into("<Q", head, 16, _PAGE * count)
    struct.pack_into("<Q", head, 32, xml_bytes)
    step = _PAGE - _CHECKSUM
    pages = [bytes(head[at : at + step]) for at in range(0, len(head), step)]
    return b"".join(page + struct.pack(">I", _crc32c(page)) for page in pages)


@cache
def _crc_table() -> list[int]:
    table = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
        table.append(value)
    return table


def _crc32c(content: bytes) -> int:
    table, value = _crc_table(), 0xFFFFFFFF
    for byte in content:
        value = value >> 8 ^ table[(value ^ byte) & 0xFF]
    return value ^ 0xFFFFFFFF


def _in_archive(content: bytes, rng: np.random.Generator) -> bytes:
    """An archive with a member changed and packed again."""
    packed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(packed, "w") as new:
        members = old.namelist()
        chosen = members[int(rng.integers(len(members)))]
        for name in members:
            body = old.read(name)
            new.writestr(name, changed(body, rng) if name == chosen else body)
    return packed.getvalue()


def _in_chunks(content: bytes, rng: np.random.Generator) -> bytes:
    """A PNG with the body of a chunk changed and its checksum set right."""
    at, chunks = 8, []
    while at + 8 <= len(content):
        (length,) = struct.unpack_from(">I", content, at)
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + length]))
        at += 12 + length
    chosen = int(rng.integers(len(chunks)))
    kind, body = chunks[chosen]
    if kind == b"IDAT" and rng.random() < 0.7:
        body = zlib.compress(changed(zlib.decompress(body), rng))
    else:
        body = changed(body, rng)
    chunks[chosen] = kind, body
    return content[:8] + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    )


_BEHIND_CHECKSUMS: dict[str, Callable[[bytes, np.random.Generator], bytes]] = {
    ".e57": _in_pages,
    ".npz": _in_archive,
    ".png": _in_chunks,
}
