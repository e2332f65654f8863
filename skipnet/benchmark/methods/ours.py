"""skipnet itself, with the options of its own config."""

from __future__ import annotations

import time
from typing import Any

from skipnet.benchmark.methods import Estimate, Method, Task
from skipnet.registration.result import Registration

TRANSFORM_STAGES = ("hypotheses", "verification")
FINE_STAGES = ("fine alignment",)
"""Stages of ``Registration.timings_s`` in the paper's split; the others make voxels and map."""


def make(
    voxel_size_m: float | None = None,
    voxel_scale: float = 1.0,
    seed: int = 0,
    **options: Any,
) -> Method:
    """skipnet's registration; its modules are imported here, before any pair is timed.

    It is given what ``register.py`` would have: the clouds alone. Where the sensors stood it must
    find out.

    Args:
        voxel_size_m: None chooses it from the data.
        voxel_scale: multiplies that choice, for ablations.
        seed: of the registration's random choices.
        **options: fields of ``skipnet.config.RegistrationConfig``, the others keep their defaults.
    """
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    from skipnet.registration.options import RegistrationConfig
    from skipnet.registration.pipeline import register
    from skipnet.skipmap.resolution import choose_voxel_size

    try:
        merged = OmegaConf.merge(OmegaConf.structured(RegistrationConfig), options)
        config: RegistrationConfig = OmegaConf.to_object(merged)  # type: ignore[assignment]
    except OmegaConfBaseException as error:
        raise ValueError(f"options of skipnet: {str(error).splitlines()[0]}") from error

    def run(task: Task) -> Estimate:
        """Answer one task."""
        started = time.perf_counter()
        size_m = voxel_size_m
        if size_m is None and voxel_scale != 1.0:
            size_m = voxel_scale * choose_voxel_size(task.source_m, task.target_m)
        result = register(
            task.source_m, task.target_m, voxel_size_m=size_m, seed=seed, config=config
        )
        return _estimate(result, time.perf_counter() - started)

    return run


def _estimate(result: Registration, time_s: float) -> Estimate:
    transform_s = sum(result.timings_s.get(stage, 0.0) for stage in TRANSFORM_STAGES)
    fine_s = sum(result.timings_s.get(stage, 0.0) for stage in FINE_STAGES)
    return Estimate(
        T_target_source=result.T_target_source,
        T_target_source_coarse=result.T_target_source_coarse,
        # Whatever is neither the transform nor the fine match prepares them: all that is left of
        # the call.
        stage_s={"map": time_s - transform_s - fine_s, "transform": transform_s, "fine": fine_s},
        status=result.status,
        confidence=result.confidence,
        margin=None if result.findings is None else result.findings.margin,
        reason=result.reason,
        timings_s=dict(result.timings_s),
    )
