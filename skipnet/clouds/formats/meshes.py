"""Meshes (OBJ, STL, GLB, OFF), through trimesh: sampled, or the vertices of dense ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from skipnet.checks import missing_package
from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.sampling import is_coarse, sample_triangles
from skipnet.types import IntArray


def read_mesh(path: Path, kind: str) -> Iterator[Cloud]:
    """Points on a mesh's faces; the vertices themselves of one without faces, or with many.

    Args:
        path: of the file.
        kind: "obj", "stl", "glb" or "off", whatever the file is called.

    Raises:
        ValueError: it is damaged or empty.
    """
    try:
        import trimesh
    except ModuleNotFoundError as error:
        raise missing_package(path, "trimesh") from error
    try:
        with open(path, "rb") as file:
            # Alone: nothing that the file names beside itself is looked for.
            loaded = trimesh.load_scene(file, file_type=kind, skip_materials=True)
        parts = [
            (
                np.asarray(getattr(part, "vertices", np.empty((0, 3))), np.float64),
                getattr(part, "faces", None),
                _colours(part),
            )
            for part in loaded.dump()
        ]
        if not all(vertices.ndim == 2 and vertices.shape[1] == 3 for vertices, _, _ in parts):
            raise ValueError("its vertices are no places")
    except Exception as error:  # trimesh passes on whatever its parsers raise
        message = " ".join(str(error).split())[:160]
        raise ValueError(f"{path}: truncated or not a mesh ({kind}): {message}") from error
    yield _cloud(parts, path)


def _colours(part: object) -> IntArray | None:
    visual = getattr(part, "visual", None)
    if getattr(visual, "kind", None) != "vertex":
        return None
    colours = np.asarray(getattr(visual, "vertex_colors", None), np.uint8)
    return colours[:, :3] if colours.ndim == 2 else None


def _cloud(parts: list[tuple[np.ndarray, np.ndarray | None, IntArray | None]], path: Path) -> Cloud:
    starts = np.cumsum([0, *(len(vertices) for vertices, _, _ in parts)])
    if starts[-1] == 0:
        raise ValueError(f"{path}: holds no points")
    colours = [colour for _, _, colour in parts if colour is not None]
    vertices = Cloud(
        np.concatenate([vertices for vertices, _, _ in parts]),
        colour=np.concatenate(colours) if len(colours) == len(parts) else None,
        name=str(path),
        notes=("the file names no unit: taken as metres",),
    )
    faces = [
        np.asarray(faces, np.int64).reshape(-1, 3) + start
        for (_, faces, _), start in zip(parts, starts, strict=False)
        if faces is not None
    ]
    triangles = np.concatenate(faces) if faces else np.empty((0, 3), np.int64)
    if not len(triangles) or not is_coarse(len(vertices)):
        return vertices
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise ValueError(f"{path}: damaged: a face names a vertex that does not exist")
    return sample_triangles(vertices, triangles)
