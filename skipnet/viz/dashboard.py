"""TensorBoard: thin helpers over ``SummaryWriter``, shared by training and evaluation.

Meshes go through TensorBoard's own plugin (``add_mesh``), which draws in the browser; Open3D's
renders on the server and needs a GPU or EGL.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from skipnet.types import FloatArray, IntArray
from skipnet.viz.colours import class_colours, curvature_colours
from skipnet.viz.pictures import draw_confusion_matrix
from skipnet.viz.views import png_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from torch.utils.tensorboard import SummaryWriter

    from skipnet.viz.dots import DotPicture

_DOT_SIZE = {"cls": "PointsMaterial", "size": 0.08}


@contextmanager
def open_dashboard(folder: str | os.PathLike[str]) -> Iterator[SummaryWriter]:
    """A writer of TensorBoard events into ``folder``, closed at the end of the block."""
    from torch.utils.tensorboard import SummaryWriter

    writer = SummaryWriter(log_dir=str(folder))
    try:
        yield writer
    finally:
        writer.close()


def log_scalars(writer: SummaryWriter, values: Mapping[str, float], step: int) -> None:
    """One curve per name, such as ``loss/train``; names with the same first part share a panel."""
    for name, value in values.items():
        writer.add_scalar(name, value, step)


def log_hyperparameters(
    writer: SummaryWriter, parameters: Mapping[str, object], scores: Mapping[str, float]
) -> None:
    """The run's row in the HPARAMS tab, in the run itself (``add_hparams`` opens a second).

    Sections of parameters come under dotted names.
    """
    from torch.utils.tensorboard.summary import hparams

    plain = {
        name: value if isinstance(value, bool | int | float | str) else str(value)
        for name, value in _flat(parameters).items()
    }
    file_writer = writer._get_file_writer()
    for summary in hparams(plain, dict(scores)):
        file_writer.add_summary(summary)
    log_scalars(writer, scores, step=0)


def _flat(parameters: Mapping[str, object], above: str = "") -> dict[str, object]:
    flat: dict[str, object] = {}
    for name, value in parameters.items():
        is_section = isinstance(value, Mapping)
        flat |= _flat(value, f"{above}{name}.") if is_section else {f"{above}{name}": value}  # type: ignore[arg-type]
    return flat


def log_embedding(
    writer: SummaryWriter,
    tag: str,
    vectors: FloatArray,
    labels: Sequence[Sequence[str]],
    columns: Sequence[str],
    step: int = 0,
) -> None:
    """(N, D) vectors in the PROJECTOR tab, each with one label per column."""
    rows = [list(row) for row in labels]
    writer.add_embedding(vectors, rows, metadata_header=list(columns), tag=tag, global_step=step)


def log_figure(writer: SummaryWriter, tag: str, figure: Figure | DotPicture, step: int = 0) -> None:
    """A Matplotlib figure in the IMAGES tab."""
    log_png(writer, tag, png_bytes(figure, dpi=100), step)


def log_png(writer: SummaryWriter, tag: str, png: bytes, step: int = 0) -> None:
    """A PNG file's content in the IMAGES tab."""
    from matplotlib.image import imread

    pixels = imread(io.BytesIO(png), format="png")[..., :3]
    writer.add_image(tag, pixels, step, dataformats="HWC")


def log_confusion_matrix(
    writer: SummaryWriter, tag: str, counts: IntArray, names: Sequence[str], step: int = 0
) -> None:
    """(C, C) counts[true, predicted] as a picture, and each class's recall as a curve."""
    log_figure(writer, tag, draw_confusion_matrix(counts, names), step)
    recalls = np.diag(counts) / np.maximum(np.sum(counts, axis=1), 1)
    for name, recall in zip(names, recalls, strict=True):
        writer.add_scalar(f"{tag}_recall/{name}", float(recall), step)


def log_skipmap_by_curvature(
    writer: SummaryWriter, tag: str, centroids_m: FloatArray, curvatures: FloatArray, step: int = 0
) -> None:
    """(V, 3) voxel centres in 3D by (V,) curvature: dark blue flat, bright yellow curved."""
    log_dots(writer, tag, centroids_m, curvature_colours(curvatures), step)


def log_skipmap_by_class(
    writer: SummaryWriter, tag: str, centroids_m: FloatArray, classes: IntArray, step: int = 0
) -> None:
    """(V, 3) voxel centres in 3D in the colours of their (V,) ``FeatureClass``."""
    log_dots(writer, tag, centroids_m, class_colours(classes), step)


def log_dots(
    writer: SummaryWriter, tag: str, centroids_m: FloatArray, colours: IntArray, step: int = 0
) -> None:
    """(N, 3) points in 3D in their (N, 3) uint8 colours, in the MESH tab."""
    import torch

    vertices = torch.from_numpy(np.asarray(centroids_m, dtype=np.float32))[None]
    tints = torch.from_numpy(np.ascontiguousarray(colours))[None]
    writer.add_mesh(tag, vertices, tints, config_dict={"material": _DOT_SIZE}, global_step=step)
