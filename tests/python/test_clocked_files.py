"""Logs in TDMS and MDF, written by the usual libraries, are those of the same columns in Parquet."""

import gc
import shutil
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from asammdf import MDF, Signal
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, TdmsWriter

from linkside import ExtendedKalmanFilter, Log, LogError, RecordingWarning, Robot, cli
from linkside.files.opening import open_table

FOLDER = Path(__file__).parents[1] / "data/arm2_square"
WHOLE = pd.read_parquet(FOLDER / "log.parquet")
MOTORS = [f"{signal}_{joint}" for signal in ("theta", "tau") for joint in ("axis2", "axis3")]
FORCE = [f"tool_acc_{axis}" for axis in "xyz"]
PERIOD = float(np.median(np.diff(WHOLE.t)))
FAST, SLOW = WHOLE.t.to_numpy(), WHOLE.t.to_numpy()[::4] + 0.3 * PERIOD
READ = {name: np.interp(SLOW, WHOLE.t, WHOLE[name]) for name in FORCE}
START = np.datetime64("2026-11-30T21:00:00", "us")


def robot(folder, text=""):
    shutil.copy(FOLDER / "robot.urdf", folder)
    (folder / "robot.yaml").write_text((FOLDER / "robot.yaml").read_text() + text)
    return Robot.load(folder / "robot.yaml")


def write_tdms(path, *, clock="waveform"):
    """Motors and accelerometer in groups of their own, each with its clock; and text, and a channel without one."""
    channels = []
    for group, times, columns in (
        ("drives", FAST, {name: WHOLE[name].to_numpy() for name in MOTORS}),
        ("daq", SLOW, READ),
    ):
        step = float(np.median(np.diff(times)))
        late = np.timedelta64(round(1e6 * times[0]), "us")
        for name, values in columns.items():
            waveform = {"wf_start_time": START + late, "wf_start_offset": times[0] - late.astype(float) / 1e6}
            kept = {**waveform, "wf_increment": step, "wf_samples": 1} if clock == "waveform" else {}
            channels.append(ChannelObject(group, name, values, properties=kept))
        if clock == "channel":
            channels.append(ChannelObject(group, "Time", 1e3 * times))
        if clock == "dates":
            channels.append(ChannelObject(group, "Time", START + (1e6 * times).round().astype("timedelta64[us]")))
        channels.append(ChannelObject(group, "remark", ["all well"] * 3))
    with TdmsWriter(path) as writer:
        for begin in (0, len(FAST) // 2):  # as LabVIEW writes: piece by piece
            writer.write_segment([_piece(channel, begin, len(FAST) // 2) for channel in channels])


def _piece(channel, begin, half):
    count = len(channel.data)
    rows = slice(0, round(count * half / len(FAST))) if begin == 0 else slice(round(count * half / len(FAST)), None)
    return ChannelObject(channel.group, channel.channel, channel.data[rows], properties=channel.properties)


def write_mdf(path, *, version="4.10"):
    """The same, positions as counts with a conversion, one sample invalid."""
    counts = {name: np.round(WHOLE[name] / 1e-9).astype(np.int64) for name in MOTORS[:2]}
    kinds = {name: {"a": 1e-9, "b": 0.0} for name in counts}
    drives = [
        Signal(counts.get(name, WHOLE[name].to_numpy()), FAST, name=name, conversion=kinds.get(name)) for name in MOTORS
    ]
    invalid = np.zeros(len(SLOW), bool)
    invalid[7] = version.startswith("4")
    bits = {"invalidation_bits": invalid} if version.startswith("4") else {}
    forces = [Signal(READ[name], SLOW, name=name, **bits) for name in FORCE]
    with MDF(version=version) as file:
        file.append(drives)
        file.append(forces)
        file.save(path, overwrite=True)


def merged(arm):
    """What the same is, merged from tables."""
    return Log.merge([WHOLE[["t", *MOTORS]], pd.DataFrame({"t": SLOW, **READ})], arm, check=False)


def equal(log, other, **tolerance):
    assert len(log) == len(other)
    for signal in ("t", "theta", "tau", "acceleration"):
        np.testing.assert_allclose(getattr(log, signal), getattr(other, signal), **tolerance)


def test_tdms_by_waveforms(tmp_path):
    write_tdms(tmp_path / "log.tdms")
    arm = robot(tmp_path)
    log = Log.read(tmp_path / "log.tdms", arm)
    equal(log, merged(arm), rtol=1e-12, atol=1e-9)
    pieces = list(Log.stream(tmp_path / "log.tdms", arm, rows=500))
    assert np.array_equal(np.concatenate([piece.theta for piece in pieces]), log.theta, equal_nan=True)
    assert pieces[0].period == log.period


@pytest.mark.parametrize(("clock", "unit"), [("channel", "ms"), ("dates", "ms")])
def test_tdms_by_a_channel_of_time(tmp_path, clock, unit):
    write_tdms(tmp_path / "log.tdms", clock=clock)
    arm = robot(tmp_path, f"columns: {{t: Time}}\nunits: {{t: {unit}}}\n")
    log = Log.read(tmp_path / "log.tdms", arm)
    whole = merged(robot(tmp_path))
    if clock == "dates":
        np.testing.assert_allclose(log.t, whole.t - whole.t[0], atol=1.1e-6)  # dates have microseconds here
    else:
        equal(log, whole, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("version", ["4.10", "3.30"])
def test_mdf(tmp_path, version):
    write_mdf(tmp_path / "log.mf4", version=version)
    found = next(path for path in tmp_path.iterdir())  # asammdf gives version 3 a suffix of its own
    path = found.rename(tmp_path / ("log.mf4" if version == "4.10" else "log.mdf"))
    arm = robot(tmp_path)
    log, whole = Log.read(path, arm), merged(arm)
    np.testing.assert_allclose(log.theta, whole.theta, atol=1e-9)
    np.testing.assert_allclose(log.tau, whole.tau, rtol=1e-12)
    missing = np.isnan(log.acceleration[:, 0]) & ~np.isnan(whole.acceleration[:, 0])
    assert missing.sum() == (version == "4.10")
    assert log.t[missing].tolist() == pytest.approx(SLOW[7:8].tolist() if version == "4.10" else [])
    there = ~np.isnan(log.acceleration)
    np.testing.assert_allclose(log.acceleration[there], whole.acceleration[there], rtol=1e-12)


@pytest.mark.parametrize(("suffix", "write"), [("tdms", write_tdms), ("mf4", write_mdf)])
def test_estimated_on_the_command_line(tmp_path, suffix, write):
    path = tmp_path / f"log.{suffix}"
    write(path)
    arm = robot(tmp_path)
    command = ["estimate", str(tmp_path / "robot.yaml"), str(path), "--with", "ekf", "--out", str(tmp_path)]
    done = CliRunner().invoke(cli.main, command)
    assert done.exit_code == 0, done.output
    want = ExtendedKalmanFilter(arm).run(Log.read(path, arm))
    written = pd.read_parquet(tmp_path / "log.estimate.parquet")
    np.testing.assert_array_equal(written[["q_axis2", "q_axis3"]].to_numpy(), want.q)


def test_commands_are_on_lines_and_names_have_their_group(tmp_path):
    waveform = {"wf_increment": 0.01, "wf_start_offset": 0.0}
    with TdmsWriter(tmp_path / "log.tdms") as writer:
        writer.write_segment(
            [
                ChannelObject("a", "theta_axis2", np.arange(5.0), properties=waveform),
                ChannelObject("a", "theta_axis3", np.arange(5.0), properties=waveform),
                ChannelObject("b", "qref_axis2", np.arange(3.0), properties={**waveform, "wf_increment": 0.02}),
                ChannelObject("a", "same", np.arange(5.0), properties=waveform),
                ChannelObject("b", "same", np.arange(5.0), properties=waveform),
                ChannelObject("b", "timeless", np.arange(5.0)),
            ]
        )
    names = open_table(tmp_path / "log.tdms").names
    assert names == ["t", "theta_axis2", "theta_axis3", "a/same", "qref_axis2", "b/same"]
    log = Log.read(tmp_path / "log.tdms", robot(tmp_path), check=False)
    assert log.qref[:, 0].tolist() == [0, 0.5, 1, 1.5, 2]


def test_what_cannot_be_used_is_said(tmp_path, monkeypatch):
    arm = robot(tmp_path)
    path = tmp_path / "log.tdms"
    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("a", "theta_axis2", np.arange(5.0))])
    with pytest.raises(LogError, match=r"log.tdms: no channel has a time: neither its own, nor a channel 't'"):
        Log.read(path, arm)
    with TdmsWriter(path) as writer:
        motors = [ChannelObject("a", f"theta_axis{k}", np.arange(5.0)) for k in (2, 3)]
        writer.write_segment([*motors, ChannelObject("a", "t", np.array([0.0, 1.0, 1.0, 2.0, 3.0]))])
    with pytest.raises(LogError, match=r"log.tdms: a: time does not increase at row 2"):
        Log.read(path, arm)
    write_tdms(path)
    path.write_bytes(path.read_bytes()[:-5000])
    with pytest.warns(RecordingWarning, match=r"log.tdms: this file was cut off"):
        log = Log.read(path, arm)
    read = log.theta[~np.isnan(log.theta)]
    assert len(WHOLE) <= len(read) < 2 * len(WHOLE)
    assert read.tolist() == WHOLE[MOTORS[:2]].to_numpy().ravel()[: len(read)].tolist()
    write_tdms(path)
    write_mdf(tmp_path / "log.mf4")
    for module, name, extra in (("nptdms", "log.tdms", "tdms"), ("asammdf", "log.mf4", "mdf")):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(LogError, match=rf"{name}: .* pip install 'linkside\[{extra}\]'"):
            Log.read(tmp_path / name, arm)


@pytest.fixture(scope="module")
def intact(tmp_path_factory):
    folder = tmp_path_factory.mktemp("broken")
    write_tdms(folder / "log.tdms")
    write_mdf(folder / "log.mf4")
    return folder


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of asammdf's broken files
@pytest.mark.filterwarnings("ignore::linkside.errors.RecordingWarning")
@given(st.sampled_from(["tdms", "mf4"]), st.data())
@settings(max_examples=6)
def test_broken_files_are_log_errors(intact, suffix, data):
    content = bytearray((intact / f"log.{suffix}").read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at : at + 1] = data.draw(st.binary(max_size=3))
    path = intact / f"broken.{suffix}"
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    with suppress(LogError):
        open_table(path).read(open_table(path).names[:2])
    gc.collect()  # what asammdf leaves open is complained of here, not in another test
