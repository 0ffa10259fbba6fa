"""Files: what killed runs leave is cleared, what is no file is refused at once, messages are one printable line."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from linkside import ConfigError, EstimateWriter, EstimatorError, LinksideError, Log, LogError, OutputError, Robot, demo
from linkside.calibration import calibrate
from linkside.calibration.resume import kept
from linkside.cli import main
from linkside.errors import LONGEST
from linkside.files.parts import PART, SPILL, clear, open_part, spill_folder
from linkside.files.writing import check_writable, write_text
from linkside.files.yaml_source import Source

ROBOT = Robot.load(demo.ROBOT)

HOLD = """
import pathlib, sys, time
from linkside.files.parts import open_part, spill_folder
folder = pathlib.Path(sys.argv[1])
part, file = open_part(folder / "out.csv")
with spill_folder(folder) as spill:
    (spill / "rows").write_text("rows")
    print("ready", flush=True)
    time.sleep(60)
"""


def leftovers(folder):
    return sorted(path.suffix for path in folder.iterdir())


def test_what_a_killed_run_left_is_cleared_and_what_one_still_writes_is_not(tmp_path):
    run = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert run.stdout.readline() == "ready\n"
    clear(tmp_path)
    assert leftovers(tmp_path) == [PART, SPILL]
    run.send_signal(signal.SIGKILL)
    run.wait()
    run.stdout.close()
    assert leftovers(tmp_path) == [PART, SPILL]
    check_writable(tmp_path / "other.csv")
    assert leftovers(tmp_path) == []


def test_spills_and_parts_lie_beside_the_output_and_are_gone_at_the_end(tmp_path):
    part, file = open_part(tmp_path / "out.csv")
    with file, spill_folder(tmp_path) as spill:
        assert part.parent == spill.parent == tmp_path
    part.unlink()
    assert leftovers(tmp_path) == []


def test_who_clears_a_folder_takes_nothing_from_who_just_began_to_write(tmp_path):
    def write(number):
        for _ in range(100):
            check_writable(tmp_path / f"{number}.csv")
            write_text(tmp_path / f"{number}.txt", str(number))
            with spill_folder(tmp_path) as spill:
                (spill / "rows").write_text("rows")

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(8)))
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{number}.txt" for number in range(8)]


@pytest.mark.parametrize("name", ["log.parquet", "log.csv", "robot.yaml"])
def test_a_pipe_is_refused_at_once(tmp_path, name):
    os.mkfifo(tmp_path / name)
    began = time.perf_counter()
    with pytest.raises(LinksideError, match="this is a named pipe, a file is expected"):
        Source.read(tmp_path / name) if name.endswith("yaml") else Log.read(tmp_path / name, ROBOT)
    assert time.perf_counter() - began < 1


def test_a_device_is_refused_at_once():
    with pytest.raises(ConfigError, match="this is a device, a file is expected"):
        Source.read("/dev/zero")


def test_links_in_a_circle_are_refused_at_once(tmp_path):
    loop = tmp_path / "loop.parquet"
    loop.symlink_to(loop)
    with pytest.raises(LogError, match=r"(?i)symbolic links"):
        Log.read(loop, ROBOT)
    for call in (check_writable, EstimateWriter):
        with pytest.raises(OutputError, match=r"(?i)symbolic links"):
            call(loop)
    result = CliRunner().invoke(main, ["estimate", str(demo.ROBOT), str(demo.LOG), "--out", str(loop)])
    assert result.exit_code == 2
    assert result.stderr.startswith("linkside: ")
    assert result.stderr.count("\n") == 1
    assert loop.is_symlink()


@pytest.mark.parametrize("yaml", ["[" * 100 + "]" * 100, "{a: " * 60 + "1" + "}" * 60])
def test_settings_that_nest_without_end_are_a_message(tmp_path, yaml):
    (tmp_path / "robot.yaml").write_text(f"joints: {yaml}")
    with pytest.raises(ConfigError, match="at most 32 deep"):
        Source.read(tmp_path / "robot.yaml")


def test_aliases_of_aliases_are_a_message(tmp_path):
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    (tmp_path / "robot.yaml").write_text("\n".join(lines))
    with pytest.raises(ConfigError, match="at most 200000 values"):
        Source.read(tmp_path / "robot.yaml")


@pytest.mark.parametrize("z", ['{"stiffness_a1": NaN}', '{"stiffness_a1": Infinity}', "[1]", '{"a": {}}'])
def test_resuming_from_what_is_no_state_is_refused(tmp_path, z):
    path = tmp_path / "out.yaml.partial"
    path.write_text(f'{{"z": {z}}}')
    with pytest.raises(ConfigError, match=r"finite number|expected the state of a calibration"):
        kept(path)


def test_resuming_from_names_that_are_not_known_is_refused():
    log = Log.from_table(pq.read_table(demo.LOG), ROBOT)
    with pytest.raises(EstimatorError, match="'foo' is not a free parameter of this calibration"):
        calibrate(ROBOT, log, ["stiffness"], start={"foo": 1.0})
    with pytest.raises(EstimatorError, match="'stiffness_a1' is nan"):
        calibrate(ROBOT, log, ["stiffness"], start={"stiffness_a1": float("nan")})


@pytest.mark.parametrize("text", ["a\nb\r\n c", "\x1b[31mred\x07", "x" * 10_000, "\ud800", "µ σ é"])
def test_messages_are_one_printable_line_of_at_most_500_characters(text):
    for error in (LinksideError, LogError, OutputError):
        message = str(error(text))
        assert message.isprintable()
        assert len(message) <= LONGEST
    assert str(LogError("µ σ é")) == "µ σ é"
    assert json.dumps(str(LogError(text)))
