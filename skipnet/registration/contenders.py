"""The poses in the running, with what is known of each: it need not be worked out again."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from skipnet.registration.alignment.refinement import Refinement, no_refinement
from skipnet.registration.judging.score import Score
from skipnet.types import FloatArray, IntArray


@dataclass(frozen=True)
class Contenders:
    """(C,) aligned candidates with what the judge says of each."""

    coarse: FloatArray
    """(C, 4, 4) as they were proposed."""
    fine: Refinement
    """Their rough alignment."""
    T_target_source: FloatArray
    """(C, 4, 4) after it; slides may have moved them."""
    score: Score
    """The judge's figures for these."""

    @staticmethod
    def none() -> Contenders:
        """Before any candidate."""
        no_poses = np.zeros((0, 4, 4))
        nothing = Score(*(np.zeros(0) for _ in fields(Score)))
        return Contenders(no_poses, no_refinement(no_poses), no_poses, nothing)

    def __len__(self) -> int:
        return len(self.coarse)

    def __getitem__(self, rows: IntArray | slice) -> Contenders:
        """Those of some rows."""
        return Contenders(*(getattr(self, one.name)[rows] for one in fields(self)))

    def joined(self, others: Contenders) -> Contenders:
        """These, then the others."""
        return Contenders(
            np.concatenate([self.coarse, others.coarse]),
            self.fine.joined(others.fine),
            np.concatenate([self.T_target_source, others.T_target_source]),
            self.score.joined(others.score),
        )

    @property
    def best_total(self) -> float:
        """The best one's score; 0 without any."""
        return float(self.score.total.max(initial=0.0))
