"""How the descriptor's training pairs are scanned and degraded: options, which need no package."""

from __future__ import annotations

from dataclasses import dataclass, field

from skipnet.checks import require


@dataclass
class Recipe:
    """How scenes are scanned, degraded and cut into examples; every share is one of pairs of scans.

    All lengths follow the voxel size, which is drawn too: so nothing here has a scale.
    """

    rings_share: float = 0.25
    """Taken by a spinning scanner of 16 channels."""
    camera_share: float = 0.25
    """Seen by two cameras of a narrow view that look at about the same point."""
    fused_share: float = 0.2
    """Fused from two places each: nothing says which side of a surface was seen."""
    aim_error: float = 0.2
    """How far apart the cameras aim, as a share of their distance from the point."""
    voxel_octaves: float = 1.0
    """The usual voxel size is multiplied by a power of two between minus and plus this."""
    noise_voxels: list[float] = field(default_factory=lambda: [0.0, 0.05, 0.15])
    """Deviations of the points' noise, in voxels, one of which is drawn for a pair."""
    least_kept: float = 0.3
    """Of a scan's points between this share and all are kept."""
    holes: int = 6
    """Up to so many balls of points, of 2 to 12 voxels, are taken out of each scan."""
    curved_share: float = 0.8
    """So many of the examples are drawn by curvature; the rest evenly."""
    turned_share: float = 0.4
    """Shown with all their surfaces seen from the back."""

    def __post_init__(self) -> None:
        for name in ("rings_share", "camera_share", "fused_share", "curved_share", "turned_share"):
            share = getattr(self, name)
            require(0 <= share <= 1, f"augmentation.{name}", share, "0 to 1")
        shares = self.rings_share + self.camera_share + self.fused_share
        require(shares <= 1, "augmentation shares", shares, "at most 1 together")
        kept = self.least_kept
        require(0 < kept <= 1, "augmentation.least_kept", kept, "above 0, at most 1")
        noise = self.noise_voxels
        known = bool(noise) and min(noise) >= 0
        require(known, "augmentation.noise_voxels", noise, "one or more of 0 or more")
        for name in ("aim_error", "voxel_octaves", "holes"):
            value = getattr(self, name)
            require(value >= 0, f"augmentation.{name}", value, "0 or more")
