"""Any folder with a pairs.json: scans, reference transforms and thresholds, pair by pair."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from skipnet.benchmark.datasets.layout import Layout
from skipnet.benchmark.datasets.pairset import Listed
from skipnet.benchmark.options import ProtocolKind
from skipnet.geometry import invert
from skipnet.storage import is_inside, read_json

PAIRS_FILE = "pairs.json"


def list_pairs(folder: Path) -> list[Listed]:
    """The pairs that ``pairs.json`` lists.

    Each entry of its list ``pairs`` has set, source, target (paths in the folder), T_target_source
    (4x4, metres), success_rotation_deg, success_translation_m and perhaps overlap.

    Raises:
        FileNotFoundError: no such file in the folder.
        ValueError: it is not such a file; an entry that is wrong is named by its number.
    """
    path = folder / PAIRS_FILE
    if not path.is_file():
        raise FileNotFoundError(f"no {PAIRS_FILE} in {folder}")
    entries = read_json(path).get("pairs")
    if not isinstance(entries, list) or not entries:
        got = f"{type(entries).__name__} {entries}"[:60]
        raise ValueError(f'{path}: "pairs" must be a list with an entry or more, got {got}')
    pairs = []
    for number, entry in enumerate(entries):
        try:
            pairs.append(_parse(entry, folder))
        except KeyError as error:
            raise ValueError(f"{path}, entry {number}: it has no {error}") from error
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}, entry {number}: {error}") from error
    return pairs


def _parse(entry: dict[str, Any], folder: Path) -> Listed:
    if not isinstance(entry, dict):
        raise ValueError(f"expected an object with set, source and so on, got {entry!r}")
    for key in ("set", "source", "target"):
        if not isinstance(entry[key], str):
            raise ValueError(f"{key} must be a string, got {entry[key]!r}")
        if key != "set" and not is_inside(entry[key]):
            raise ValueError(f"{key} must be a path in the folder, got {entry[key]!r}")
    name = f"{entry['set']}/{Path(entry['source']).stem}-to-{Path(entry['target']).stem}"
    T_target_source = np.asarray(entry["T_target_source"], dtype=np.float64)
    if T_target_source.shape != (4, 4) or not np.isfinite(T_target_source).all():
        shape = T_target_source.shape
        raise ValueError(f"{name}: T_target_source must be 4x4 numbers, got shape {shape}")
    is_rigid = np.allclose(T_target_source @ invert(T_target_source), np.eye(4), atol=1e-3)
    if not is_rigid or np.linalg.det(T_target_source[:3, :3]) < 0:
        raise ValueError(f"{name}: T_target_source must be a rigid motion, got {T_target_source}")
    overlap = entry.get("overlap")
    for key in ("success_rotation_deg", "success_translation_m"):
        if not 0 < float(entry[key]) < np.inf:
            raise ValueError(f"{name}: {key} must be above 0, got {entry[key]}")
    return Listed(
        name=name,
        set_name=entry["set"],
        source=folder / entry["source"],
        target=folder / entry["target"],
        T_target_source=T_target_source,
        overlap=None if overlap is None else float(overlap),
        success_rotation_deg=float(entry["success_rotation_deg"]),
        success_translation_m=float(entry["success_translation_m"]),
    )


FOLDER = Layout(
    "folder",
    list_pairs,
    PAIRS_FILE,
    "any folder of scans that you list there",
    ProtocolKind.own,
)
