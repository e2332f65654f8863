"""An interrupt ends a command at once, with one line, whatever its helpers wait for."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from skipnet.commands.main import main

INTERRUPTED = """
import os, signal, sys
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from skipnet.commands import hydra_app
from skipnet.parallel.threads import _helpers

signal.signal(signal.SIGINT, signal.default_int_handler)  # where tests run in the background, too

@dataclass
class Config:
    width_m: float = 1.0

def task(config):
    lock = Lock()
    lock.acquire()
    _helpers().submit(lock.acquire)  # waits for ever, as for a compiler that was interrupted
    {how}

hydra_app.run("toy", Config, task, arguments=[], config_dir=Path(sys.argv[1]))
print("went on")
"""
POOL = """
import os, sys, time
sys.path.insert(0, {folder!r})
from skipnet.parallel.pools import worker_pool
if __name__ == "__main__":
    with worker_pool(2) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        time.sleep(60)
"""


@pytest.mark.parametrize(
    "how",
    [
        "os.kill(os.getpid(), signal.SIGINT)",
        "exec('try: raise KeyboardInterrupt\\nexcept BaseException: raise ImportError(\"half\")')",
    ],
)
def test_an_interrupt_is_one_line_and_no_helper_is_waited_for(tmp_path, how):
    (tmp_path / "toy.yaml").write_text("defaults: [toy_schema, _self_]\n")
    command = [sys.executable, "-c", INTERRUPTED.format(how=how), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 130
    assert done.stderr == "toy: interrupted; what was written before is whole\n"
    assert done.stdout == ""


def test_an_interrupt_before_the_command_begins_is_one_line(monkeypatch, capsys):
    def import_module(name):
        raise KeyboardInterrupt

    monkeypatch.setattr("skipnet.commands.main.import_module", import_module)
    assert main(["register"]) == 130
    assert capsys.readouterr().err == "register: interrupted; nothing was begun\n"


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells a child of its parent's end")
def test_a_killed_run_leaves_no_worker_behind(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(POOL.format(folder=str(Path(__file__).parents[2])))
    run = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    status = Path(f"/proc/{int(run.stdout.readline())}/status")
    run.kill()
    run.wait()
    deadline = time.monotonic() + 20
    while is_running(status) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_running(status)


def is_running(status):
    """Whether a process is there and not dead; a dead one stays until somebody asks about it."""
    try:
        return "State:\tZ" not in status.read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False
