"""Names of files reach the program as a shell passes them."""

from __future__ import annotations

import pytest

from skipnet.commands import hydra_app
from skipnet.commands.register import RegisterConfig
from skipnet.commands.words import plain_options

NAMES = ["scan (copy).ply", "Scan,1.ply", "Büro.ply", "é中文.ply", "a'b.ply", 'a"b.ply', "#1.ply"]
NAMES += ["R&D+1@2.ply", "x=y.ply", "[1].ply", "{a}.ply", "a:b.ply", "1e5.ply", "null.ply"]
NAMES += ["~a.ply", "$HOME.ply", "a\\b.ply", 'x\\"y.ply', "-5.ply", "true", "a\\"]


def configured(*arguments, has_no_presets=False):
    seen = []
    exit_code = hydra_app.run(
        "register",
        RegisterConfig,
        seen.append,
        arguments=arguments,
        has_no_presets=has_no_presets,
    )
    assert exit_code == 0
    return seen


@pytest.mark.parametrize("name", NAMES)
def test_any_name_is_taken_as_it_is(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).touch()
    [config] = configured(f"source={name}", f"target={name}", f"output_dir={name}.out")
    assert (config.source, config.target, config.output_dir) == (name, name, f"{name}.out")
    [config] = configured(f"scans=[{name},b.ply]")
    assert config.scans == [name, "b.ply"]


def test_all_names_at_once_and_one_without_brackets(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in NAMES:
        (tmp_path / name).touch()
    assert configured(f"scans=[{','.join(NAMES)}]")[0].scans == NAMES
    assert configured("scans=some folder")[0].scans == ["some folder"]


PLAIN = [
    [],
    ["source=a.ply", "target=../b/B_2.ply"],
    ["output_dir=out/x-1", "unit=mm", "source_unit=ft", "format=laz"],
]


@pytest.mark.parametrize("arguments", PLAIN)
def test_names_alone_give_what_hydra_would_make_of_them(arguments):
    assert plain_options(arguments, RegisterConfig) is not None
    [without] = configured(*arguments, has_no_presets=True)
    assert configured(*arguments) == [without]


@pytest.mark.parametrize(
    "argument",
    ["seed=1", "unit=null", "source='a.ply'", "source=", "+unit=m", "registration=paper", "--help"],
)
def test_whatever_else_is_typed_is_hydras(argument):
    assert plain_options([argument], RegisterConfig) is None
    assert plain_options(["unit=m", "unit=mm"], RegisterConfig) is None


def test_what_hydra_knows_is_left_to_it():
    assert configured("source=null", "target=null")[0].source is None
    assert configured('source="a b.ply"', "target='c,d.ply'")[0].target == "c,d.ply"
    assert [config.unit for config in configured("--multirun", "unit=m,mm")] == ["m", "mm"]
