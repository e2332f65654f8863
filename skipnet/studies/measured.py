"""What docs/results.md shows: the command behind each of its blocks, and which tables it takes."""

from __future__ import annotations

import shlex
from dataclasses import dataclass

FOLDER = "FOLDER"
"""In a command's words: the folder of real pairs that the user names."""


@dataclass(frozen=True)
class Block:
    """Tables of one run of one command."""

    name: str
    """Of the block in the page, and of the run's folder."""
    command: str
    """As it is typed: "evaluate benchmark=overlap", "study vigilance", "train"."""
    tables: tuple[str, ...] = ()
    """How the titles of the report's tables begin; empty takes the whole of ``report``."""
    small: str = ""
    """Overrides that make it a matter of seconds: to see that it works, not to show it."""
    report: str = "report.md"
    resumes: bool = True
    """A killed run goes on where it stopped; otherwise it starts anew."""

    @property
    def needs_data(self) -> bool:
        """Whether it reads real pairs."""
        return FOLDER in self.command

    @property
    def line(self) -> str:
        """What the page shows as the command."""
        script, _, rest = self.command.partition(" ")
        head = f"skipnet {script}" if script == "study" else f"python {script}.py"
        return f"{head} {rest}".rstrip()

    def arguments(self, data: str | None, small: bool) -> list[str]:
        """Of ``python -m skipnet``, without the output folder."""
        words = shlex.split(self.command) + (shlex.split(self.small) if small else [])
        return [word.replace(FOLDER, str(data)) for word in words]


SUCCESS, SETS, SAID = "Success, error and time", "Success by set", "What the methods said"
OVERLAP, STAGES, CONFIDENCE = "Success by overlap", "Coarse and fine side by side", "Confidence"
_TINY_SCENES = (
    "data.training_scenes=2 data.validation_scenes=1 data.test_scenes=1 data.families=[closed] "
    "data.workers=1 data.most_per_class=25"
)
_TINY_PAIRS = (
    "descriptor.training_pairs=3 descriptor.validation_pairs=2 descriptor.test_pairs=2 "
    "descriptor.steps=2 descriptor.patches_per_scans=100 descriptor.patches_per_step=64"
)

BLOCKS = (
    Block(
        "paper", "evaluate pairs=20", ("Time and error of each stage", SAID), "pairs=1 points=5000"
    ),
    Block(
        "real",
        "evaluate benchmark=folder data=FOLDER",
        (SUCCESS, SETS, SAID, CONFIDENCE),
        "most_per_set=1",
    ),
    Block(
        "peers",
        "evaluate benchmark=peers pairs=2",
        (SUCCESS, SETS),
        "pairs=1 points=4000 family=oblique time_limit_s=20",
    ),
    Block(
        "peers_real",
        "evaluate benchmark=peers dataset=folder data=FOLDER most_per_set=2",
        (SUCCESS, SETS),
        "most_per_set=1 sets=[jsanchez_room] methods=[skipnet,kiss_matcher]",
    ),
    Block(
        "best_voxel",
        "evaluate benchmark=best_voxel dataset=folder data=FOLDER most_per_set=3 "
        "methods=[skipnet,kiss_voxels]",
        (SETS, "Best method of each set"),
        "most_per_set=1 sets=[jsanchez_room]",
    ),
    Block(
        "overlap",
        "evaluate benchmark=overlap pairs=4",
        (OVERLAP, SETS, SAID, CONFIDENCE),
        "pairs=1 methods=[skipnet]",
    ),
    Block(
        "kitchen",
        "evaluate benchmark=folder data=FOLDER sets=[3dmatch_redkitchen] "
        "methods=[skipnet,fpfh_sc2,fpfh_ransac,kiss_matcher]",
        (OVERLAP,),
        "most_per_set=1 methods=[skipnet]",
    ),
    Block("penalty", "evaluate benchmark=penalty", (STAGES, SAID), "pairs=1 points=20000"),
    Block("ablation", "evaluate benchmark=ablation pairs=8", (STAGES,), "pairs=1 points=20000"),
    Block(
        "ablation_doorway",
        "evaluate benchmark=ablation family=doorway pairs=8",
        (STAGES,),
        "pairs=1 points=20000 methods=[generators]",
    ),
    Block(
        "speed",
        "evaluate benchmark=speed pairs=2 speed.repeats=2",
        ("Time, ", "Time as a multiple", "Growth", "Peak memory", "Stages"),
        "pairs=1 speed.repeats=1 speed.points=[20000] methods=[skipnet,kiss_matcher]",
        resumes=False,
    ),
    Block(
        "vigilance",
        "study vigilance pairs=20 negatives=80 alike=0",
        ("What came back",),
        "pairs=1 negatives=2",
    ),
    Block("accuracy", "study accuracy pairs=12", ("Error of the source",), "pairs=1"),
    Block("projects", "study projects floors=1 seed=1", ("Scans placed",), resumes=False),
    Block(
        "inliers",
        "study inliers data=FOLDER",
        ("Inlier ratio", "All pairs"),
        "sets=[jsanchez_room]",
        resumes=False,
    ),
    Block(
        "network",
        "train compare_alone=true data.test_scenes=20 descriptor.test_pairs=32",
        small=f"compare_alone=false {_TINY_SCENES} {_TINY_PAIRS}",
        report="scores.md",
    ),
    Block(
        "classes",
        "train experiment=classes compare_sklearn=true data.training_scenes=40",
        small=f"epochs=2 compare_sklearn=false {_TINY_SCENES}",
        report="scores.md",
    ),
    Block("paper_network", "train experiment=paper", small="epochs=2", report="scores.md"),
)
