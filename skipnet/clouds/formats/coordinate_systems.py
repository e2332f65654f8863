"""What a coordinate reference system says of the unit of a file's coordinates."""

from __future__ import annotations

import re
import struct

from skipnet.checks import METRES_PER_UNIT

_UNIT = re.compile(r'(?:LENGTHUNIT|UNIT)\s*\[\s*"[^"]*"\s*,\s*([0-9.eE+-]+)', re.IGNORECASE)
_GEOGRAPHIC = re.compile(r"^\s*(GEOGCS|GEOGCRS|GEODCRS)\b", re.IGNORECASE)
_DEGREE = 0.0174532925
_MODEL_KEY, _GEOGRAPHIC_MODEL, _UNIT_KEY = 1024, 2, 3076
_UNITS_OF_CODES = {9001: "m", 9002: "ft", 9003: "us_ft"}
"""EPSG's codes of the units that GeoTIFF keys name."""


DEGREES = "degrees"
"""The unit of longitude and latitude."""


def unit_of_wkt(text: str) -> str:
    """The unit of a system as well-known text: of length, ``DEGREES``, or "m" if it names none.

    The unit of a projected system is the last of its own part, behind that of the angles.

    >>> unit_of_wkt('PROJCS["a",GEOGCS["b",UNIT["degree",0.0174532925]],UNIT["ft",0.3048]]')
    'ft'
    """
    if _GEOGRAPHIC.match(text):
        return DEGREES
    horizontal = re.split(r"VERT_?CS|VERTCRS", text)[0]
    factors = [float(number) for number in _UNIT.findall(horizontal)]
    lengths = [factor for factor in factors if abs(factor - _DEGREE) > 1e-6]
    if not lengths:
        return "m"
    return min(METRES_PER_UNIT, key=lambda unit: abs(METRES_PER_UNIT[unit] - lengths[-1]))


def unit_of_geokeys(record: bytes) -> str:
    """As ``unit_of_wkt``, of a GeoTIFF key directory."""
    shorts = struct.unpack(f"<{len(record) // 2}H", record[: len(record) // 2 * 2])
    entries = [shorts[at : at + 4] for at in range(4, len(shorts) - 3, 4)]
    keys = {key: value for key, where, _, value in entries if where == 0}
    if keys.get(_MODEL_KEY) == _GEOGRAPHIC_MODEL:
        return DEGREES
    return _UNITS_OF_CODES.get(keys.get(_UNIT_KEY, 9001), "m")
