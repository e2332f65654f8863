"""What the methods answered, one JSON line per pair and method: written once, scored many times."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from skipnet.clouds.formats.arrays import read_npy
from skipnet.storage import append_line, is_inside, parsed, read_lines, replacing
from skipnet.types import FloatArray, Status

Matrix = list[list[float]]


@dataclass(frozen=True)
class Prediction:
    """One method's answer to one pair, without a trace of the truth."""

    pair: str
    method: str
    settings_hash: str
    """Of the pairs and of the method's options: answers are reused only under the same settings."""
    time_s: float
    """Wall time of the whole call, without the start of its process."""
    stage_s: dict[str, float] = field(default_factory=dict)
    """Seconds of the stages map, transform and fine, as far as the method has them."""
    timings_s: dict[str, float] = field(default_factory=dict)
    """The method's own, finer stages."""
    T_target_source: Matrix | None = None
    """Final pose; None if the method failed to give one."""
    T_target_source_coarse: Matrix | None = None
    """Pose before fine alignment; None if there is none."""
    status: str = "failed"
    confidence: float | None = None
    margin: float | None = None
    reason: str = ""
    error: str | None = None
    """Why there is no pose: the exception, or the time limit; None if the method answered."""
    correspondences: str | None = None
    """File of the method's correspondences, relative to the predictions; None if it has none."""

    def pose(self, stage: str) -> FloatArray | None:
        """The (4, 4) pose of stage "coarse" or "fine", None where there is none."""
        matrix = self.T_target_source_coarse if stage == "coarse" else self.T_target_source
        return None if matrix is None else np.array(matrix, dtype=np.float64)


def append_prediction(path: Path, prediction: Prediction) -> None:
    """Add one line."""
    append_line(path, asdict(prediction))


def save_correspondences(
    folder: Path, prediction: Prediction, source_m: FloatArray, target_m: FloatArray
) -> Prediction:
    """Write (K, 3) source and target points that a method holds for the same, and note the file."""
    digest = hashlib.sha256(prediction.pair.encode()).hexdigest()[:16]
    path = Path("correspondences") / prediction.method / f"{digest}.npy"
    clouds = np.stack([source_m, target_m]).astype(np.float32)
    with replacing(folder / path) as temporary:
        np.save(temporary, clouds)
    return replace(prediction, correspondences=path.as_posix())


def load_correspondences(
    folder: Path, prediction: Prediction
) -> tuple[FloatArray, FloatArray] | None:
    """What ``save_correspondences`` wrote; None if the method has none.

    Raises:
        FileNotFoundError: the file is gone.
        ValueError: it holds something else.
    """
    if prediction.correspondences is None:
        return None
    path = folder / prediction.correspondences
    both = read_npy(path)
    if both.ndim != 3 or both.shape[0] != 2 or both.shape[2] != 3 or both.dtype.kind != "f":
        raise ValueError(f"{path}: holds {both.dtype} of shape {both.shape}: expected (2, K, 3)")
    source_m, target_m = both.astype(np.float64)
    return source_m, target_m


def read_predictions(path: Path) -> list[Prediction]:
    """All predictions in the file, in order; empty when there is none.

    A last line that was cut off by a kill is cut from the file: its pair is predicted again.

    Raises:
        ValueError: if another line is not a prediction.
    """
    lines = enumerate(read_lines(path), start=1)
    return [_parse(line, path, number) for number, line in lines if line]


def _parse(line: str, path: Path, number: int) -> Prediction:
    try:
        prediction = Prediction(**parsed(line, "the line"))
        _check(prediction)
    except (ValueError, TypeError) as error:
        raise ValueError(
            f"{path}, line {number} is not a prediction ({error}): choose another output_dir"
        ) from error
    return prediction


def _check(prediction: Prediction) -> None:
    """Refuse what no run of ours writes; a run folder may come from anywhere."""
    texts = ("pair", "method", "settings_hash", "status", "reason")
    wrong = [name for name in texts if not isinstance(getattr(prediction, name), str)]
    for name in ("T_target_source", "T_target_source_coarse"):
        matrix = getattr(prediction, name)
        if matrix is not None and not _is_pose(matrix):
            wrong.append(name)
    for name in ("time_s", "confidence", "margin"):
        value = getattr(prediction, name)
        if not (isinstance(value, int | float) or (value is None and name != "time_s")):
            wrong.append(name)
    for name in ("stage_s", "timings_s"):
        times_s = getattr(prediction, name)
        is_table = isinstance(times_s, dict)
        if not is_table or not all(isinstance(time_s, int | float) for time_s in times_s.values()):
            wrong.append(name)
    if prediction.status not in tuple(Status):
        wrong.append("status")
    if not isinstance(prediction.error, str | None):
        wrong.append("error")
    file = prediction.correspondences
    if file is not None and not (isinstance(file, str) and is_inside(file)):
        wrong.append("correspondences")
    if wrong:
        raise ValueError(f"its {', '.join(dict.fromkeys(wrong))} cannot be right")


def _is_pose(matrix: object) -> bool:
    try:
        values = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    return values.shape == (4, 4) and bool(np.isfinite(values).all())
