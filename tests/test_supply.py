"""What skipnet is made of: licences of all it needs, and the versions that CI installs."""

from __future__ import annotations

import re
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PERMISSIVE = ("MIT", "BSD", "APACHE", "ISC", "PSF", "PYTHON SOFTWARE", "ZLIB", "CC0", "BOOST")
FILE_ONLY = ("MPL-2.0", "MOZILLA PUBLIC")
"""Changes to their own files are to be published; nothing else is asked of who uses them."""
COPYLEFT = re.compile(r"\b(A?GPL|GNU (AFFERO|GENERAL))", re.IGNORECASE)
_PINNED = r"\S+ ; .*( \\\n    --hash=sha256:[0-9a-f]{64})+"
NVIDIAS = ("cuda-", "nvidia-")
"""What PyTorch's build for graphics cards brings along, under NVIDIA's own licence for its use."""
EXTRAS = ("", "test", "peers", "formats")


def needed() -> dict[str, Distribution]:
    """All packages that skipnet, its tests and its optional formats bring along, as installed."""
    found: dict[str, Distribution] = {}

    def visit(name: str, extras: tuple[str, ...]) -> None:
        try:
            one = distribution(name)
        except PackageNotFoundError:
            return  # of another system or version of Python
        found[canonicalize_name(name)] = one
        for line in one.requires or []:
            asked = Requirement(line)
            applies = asked.marker is None or any(
                asked.marker.evaluate({"extra": extra}) for extra in extras or ("",)
            )
            if applies and canonicalize_name(asked.name) not in found:
                visit(asked.name, tuple(asked.extras))

    visit("skipnet", EXTRAS)
    return found


def licence(one: Distribution) -> str:
    """All that a package says of its licence."""
    about = one.metadata
    classes = [text for text in about.get_all("Classifier") or [] if text.startswith("License")]
    return " ".join(
        [about.get("License-Expression") or "", about.get("License") or "", *classes]
    ).upper()


def test_every_package_lets_itself_be_used_so():
    packages = needed()
    assert {"numpy", "torch", "numba", "open3d", "hydra-core"} <= set(packages)
    for name, one in packages.items():
        if name.startswith(NVIDIAS):
            continue
        said = licence(one)
        assert any(word in said for word in PERMISSIVE + FILE_ONLY), (name, said[:200])
        declared = one.metadata.get("License-Expression") or ""
        assert not COPYLEFT.search(declared), (name, declared)


def test_what_ci_installs_is_what_was_tested_and_allowed():
    text = re.sub(r"^#.*\n", "", (ROOT / ".ci" / "lock.txt").read_text(), flags=re.MULTILINE)
    blocks = re.split(r"\n(?=\w)", text.strip())
    assert all(re.fullmatch(_PINNED, block) for block in blocks)
    pins = [Requirement(block.partition(" \\\n")[0]) for block in blocks]
    names = [canonicalize_name(pin.name) for pin in pins]
    assert len(set(names)) == len(names) and names == sorted(names)
    assert all(re.fullmatch(r"==[\w.]+", str(pin.specifier)) and pin.url is None for pin in pins)
    of = dict(zip(names, pins, strict=True))
    for line in distribution("skipnet").requires or []:
        asked = Requirement(line)
        pin = of.get(canonicalize_name(asked.name))
        is_cluster = any(f'"{extra}"' in str(asked.marker) for extra in ("clusters", "ray"))
        assert is_cluster or pin is not None, line
        if pin is not None:
            assert asked.specifier.contains(str(pin.specifier).removeprefix("==")), line


@pytest.mark.parametrize("text", ["GPL-3.0-only", "AGPL-3.0", "GNU General Public License v3"])
def test_copyleft_is_told_from_the_rest(text):
    assert COPYLEFT.search(text) and not COPYLEFT.search("MIT") and not COPYLEFT.search("LGPL-2.1")
