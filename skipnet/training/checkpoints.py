"""What an interrupted training needs to go on, in one file that is whole or not there."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import torch

from skipnet.storage import write_bytes


def save_checkpoint(path: Path, identity: str, state: dict[str, Any]) -> None:
    """Write plain values and tensors, and the random state of torch, which dropout draws from.

    Args:
        path: the file; an earlier one stays until the new one is whole.
        identity: what tells this training from any other: its options, seed and data.
        state: of the training.
    """
    everything = {**state, "identity": identity, "torch_rng": torch.get_rng_state()}
    content = io.BytesIO()  # on a full disk torch itself raises what names no file
    torch.save(everything, content)
    write_bytes(path, content.getvalue())


def load_checkpoint(path: Path, identity: str, device: torch.device) -> dict[str, Any]:
    """Read what ``save_checkpoint`` wrote, and set torch's random state.

    Raises:
        ValueError: it was written by another training, or is damaged.
    """
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True, map_location=device)
        written_by, random_state = state.pop("identity"), state.pop("torch_rng").cpu()
    except OSError:
        raise
    except Exception as error:  # what torch, pickle and zipfile raise has no common base
        message = " ".join(str(error).split())[:160]
        raise ValueError(
            f"{path}: damaged, or no checkpoint: remove it to start anew ({message})"
        ) from error
    if written_by != identity:
        raise ValueError(
            f"{path} belongs to a training with other options or data; "
            "give another output_dir, or remove it to start anew"
        )
    torch.set_rng_state(random_state)
    return state
