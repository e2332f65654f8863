"""Options of the studies."""

from __future__ import annotations

from dataclasses import dataclass, field

from skipnet.checks import require


@dataclass
class StudyConfig:
    """What every study has."""

    seed: int = 0
    """Simulated: number of the first scene, among those that only this study uses
    (``skipnet.simulation.seeds``). Otherwise the seed of every random choice."""
    output_dir: str = "runs/study"
    """Folder of this run, relative to where the user stands; give an earlier one to resume it."""

    def __post_init__(self) -> None:
        require(self.seed >= 0, "seed", self.seed, "a whole number of at least 0")
        require(bool(self.output_dir), "output_dir", self.output_dir, "a folder")


@dataclass
class SimulatedStudyConfig(StudyConfig):
    """Of those that simulate scenes and register them, several at a time."""

    workers: int = 2
    """Processes; no answer depends on their number."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.workers >= 1, "workers", self.workers, "1 or more")


@dataclass
class VigilanceConfig(SimulatedStudyConfig):
    """Is the judge ever fooled?"""

    pairs: int = 50
    """Pairs of scans of each kind of scene with one right answer; of those without, a fifth."""
    negatives: int = 500
    """Pairs of scans that share nothing, half of them from one shell."""
    alike: int = 500
    """Pairs of ten kinds that are alike and not the same: one shell with other furniture,
    two specimens of a kind, mirror images."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.pairs >= 0, "pairs", self.pairs, "0 or more")
        require(self.alike >= 0, "alike", self.alike, "0 or more")
        require(self.negatives >= 0, "negatives", self.negatives, "0 or more")


@dataclass
class AccuracyConfig(SimulatedStudyConfig):
    """How near does fine alignment come to the bound, and is the truth where it says?"""

    pairs: int = 20
    """Of each family."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.pairs >= 1, "pairs", self.pairs, "1 or more")


@dataclass
class CalibrationConfig(SimulatedStudyConfig):
    """Fit the verdict's confidence."""

    scenes: int = 8
    """Scenes of each kind, each with another that it has nothing to do with."""
    ship: bool = False
    """Replace the confidence that skipnet ships by the one fitted."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.scenes >= 1, "scenes", self.scenes, "1 or more")


@dataclass
class MissesConfig(StudyConfig):
    """Why were pairs missed?"""

    run: str | None = None
    """Folder of a run of evaluate.py, its output_dir."""
    method: str = "skipnet"
    """Whose answers to look at; the descriptor and the judge are skipnet's."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(bool(self.run), "run", self.run, "run=FOLDER, the output_dir of evaluate.py")


@dataclass
class InliersConfig(StudyConfig):
    """How many right correspondences does the descriptor find?"""

    data: str | None = None
    """Folder with a pairs.json."""
    sets: list[str] = field(default_factory=list)
    """Names of the sets to use; empty takes all."""
    networks: list[str] = field(default_factory=list)
    """Others beside the shipped one, each by its name or its file, a descriptor.npz of train.py."""
    matchers: list[str] = field(default_factory=list)
    """What matches the deep one of ``networks``, each by its name or its file, a matcher.npz."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(bool(self.data), "data", self.data, "data=FOLDER, one with a pairs.json")
        fits = not self.matchers or len(self.networks) == 1
        require(fits, "networks", self.networks, "the one deep network that the matchers belong to")


@dataclass
class ProjectsConfig(SimulatedStudyConfig):
    """Are scans misplaced on floors of alike rooms?"""

    floors: int = 5
    """Of each kind."""
    peers: bool = False
    """Whether pairs in a chain, and KISS-Matcher with Open3D's pose graph, are asked too."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.floors >= 1, "floors", self.floors, "1 or more")


@dataclass
class FuzzConfig(SimulatedStudyConfig):
    """Is every damaged file read or refused in one line?"""

    files: int = 5000
    """Of each format that we read ourselves, and a fifth of each that libraries read."""
    formats: list[str] = field(default_factory=list)
    """Extensions without their dot; empty takes all."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.files >= 5, "files", self.files, "5 or more")


@dataclass
class InvariantsConfig(SimulatedStudyConfig):
    """What may a change of the scans change?"""

    pairs: int = 5
    """Of each family of simulated scenes."""
    data: str | None = None
    """Folder with a pairs.json, whose pairs are changed too."""
    most_per_set: int | None = None
    """Of the folder: at most so many pairs of each set; null takes all."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.pairs >= 1, "pairs", self.pairs, "1 or more")


@dataclass
class PicturesConfig(StudyConfig):
    """Draw the pictures of the documentation."""


@dataclass
class ResultsConfig(StudyConfig):
    """Measure every table of docs/results.md on one commit."""

    seed: int = 0
    """Handed on to every command; 0 leaves each its own."""
    output_dir: str = "runs/results"
    """Folder of the runs behind the tables; what it holds of this commit is not measured again."""
    data: str | None = None
    """Folder of real pairs with a pairs.json; null leaves their tables out."""
    only: list[str] = field(default_factory=list)
    """Names of the blocks to measure; empty takes all."""
    small: bool = False
    """Tiny sizes, and of changed files too: to see that it works, not to show it."""
    pages: list[str] = field(default_factory=lambda: ["docs/results.md", "README.md"])
    """Pages whose marked blocks are filled."""


STUDIES: dict[str, type[StudyConfig]] = {
    "vigilance": VigilanceConfig,
    "accuracy": AccuracyConfig,
    "calibration": CalibrationConfig,
    "misses": MissesConfig,
    "inliers": InliersConfig,
    "projects": ProjectsConfig,
    "fuzz": FuzzConfig,
    "invariants": InvariantsConfig,
    "pictures": PicturesConfig,
    "results": ResultsConfig,
}
"""Each is a module of this room with a ``run``, and a file of configs/study."""
