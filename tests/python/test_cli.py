"""The command line: what it writes and says, and that a user's mistake is one line and leaves nothing behind."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from operator import itemgetter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from linkside import AccelerationObserver, Estimate, Log, Noise, Robot, cli, demo, poles
from linkside.cli import terminal
from linkside.files import parts
from linkside.fleet import estimating, methods
from linkside.recording import writer

DATA = Path(__file__).parents[1] / "data"
ACCURACY = {  # RMS of the tool error, offset out [mm]
    demo.FOLDER: 0.065,
    DATA / "kr15_long": 0.19,
    DATA / "kr15_six_axes": 0.046,
    DATA / "arm2_square": 0.062,
    DATA / "arm2_square_mismatch": 0.16,
}


@pytest.fixture(autouse=True)
def _signals():
    """The command line has its own way with SIGTERM."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A copy of the demonstration to work in, and to break."""
    for name in ("robot.yaml", "robot.urdf", "log.parquet", "truth.parquet"):
        shutil.copy(demo.FOLDER / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def linkside(*arguments):
    return CliRunner().invoke(cli.main, list(map(str, arguments)))


def succeed(*arguments):
    result = linkside(*arguments)
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    return result.stdout


def refuse(*arguments, words=(), status=2):
    """One line on standard error with all the words, and no file more than before."""
    before = sorted(Path.cwd().rglob("*"))
    result = linkside(*arguments)
    assert result.exit_code == status, result.output
    assert re.fullmatch(r"linkside: .+\n", result.stderr), result.stderr
    assert sorted(Path.cwd().rglob("*")) == before
    for word in words:
        assert word in result.stderr
    return result.stderr


def estimate(*more, log="log.parquet", out="out.parquet"):
    return ("estimate", "robot.yaml", log, "--out", out, *more)


def edit(file, old, new):
    text = Path(file).read_text()
    assert old in text
    Path(file).write_text(text.replace(old, new, 1))


def alter(column, change, file="log.parquet"):
    """Rewrite a column of a recording, or leave it out."""
    table = pq.read_table(file)
    index = table.column_names.index(column)
    values = change(table.column(column).to_numpy().copy())
    table = table.remove_column(index) if values is None else table.set_column(index, column, pa.array(values))
    pq.write_table(table, file)


def put(row, value):
    def change(values):
        values[row] = value
        return values

    return change


@pytest.mark.parametrize(("recording", "bound"), ACCURACY.items(), ids=lambda value: getattr(value, "name", None))
def test_recordings_are_estimated_to_their_accuracy(tmp_path, recording, bound):
    out, truth = tmp_path / "out.parquet", recording / "truth.parquet"
    text = succeed("estimate", recording / "robot.yaml", recording / "log.parquet", "--out", out, "--truth", truth)
    error = Estimate.read(out).error_against(truth)
    assert error.tool_rms_centred <= bound
    for value in (error.tool_rms, error.tool_max, error.tool_rms_centred, error.tool_max_centred):
        assert f" {value:.4f} " in text
    last = text.splitlines()[-1]
    rows = pq.read_metadata(out).num_rows
    assert re.fullmatch(rf".*out\.parquet: {rows} rows, [\d.]+ s of motion, [\d.e+]+ µs per sample; .+", last)


@pytest.mark.parametrize("rows", [1, 7, 150, 100_000])
def test_pieces_of_any_size_give_the_same_bytes(folder, monkeypatch, rows):
    pq.write_table(pq.read_table("log.parquet").slice(0, 400), "log.parquet")
    robot = Robot.load("robot.yaml")
    AccelerationObserver(robot).run(Log.read("log.parquet", robot)).write("whole.parquet")
    succeed(*estimate())
    monkeypatch.setattr(estimating, "ROWS", rows)
    succeed(*estimate(out="pieces.parquet"))
    assert Path("pieces.parquet").read_bytes() == Path("out.parquet").read_bytes()
    assert pq.read_table("out.parquet").equals(pq.read_table("whole.parquet"))


def test_a_method_that_needs_the_whole_log_has_it(folder, monkeypatch):
    def build(robot, options):
        return lambda pieces: map(AccelerationObserver(robot).run, pieces)

    method = methods.Method("", (), build, whole=lambda _: True)
    monkeypatch.setitem(estimating.METHODS, "observer", method)
    monkeypatch.setattr(estimating, "ROWS", 7)
    succeed(*estimate())
    whole = AccelerationObserver(robot := Robot.load("robot.yaml")).run(Log.read("log.parquet", robot))
    np.testing.assert_array_equal(Estimate.read("out.parquet").q, whole.q)


KALMAN = {  # RMS of the tool error of filter and smoother, offset out [mm]
    demo.FOLDER: (0.05, 0.046),
    DATA / "kr15_long": (0.20, 0.19),
    DATA / "kr15_six_axes": (0.006, 0.003),
    DATA / "arm2_square": (0.013, 0.006),
}


@pytest.mark.parametrize("recording", KALMAN, ids=lambda value: value.name)
@pytest.mark.parametrize("method", [0, 1], ids=["ekf", "smoother"])
def test_kalman_methods_reach_their_accuracy(tmp_path, recording, method):
    out = tmp_path / "out.parquet"
    files = recording / "robot.yaml", recording / "log.parquet"
    text = succeed("estimate", *files, "--out", out, "--with", ["ekf", "smoother"][method])
    assert Estimate.read(out).error_against(recording / "truth.parquet").tool_rms_centred <= KALMAN[recording][method]
    assert re.search(r"NIS [\d.]+ per reading", text)
    assert {"q_std_" + Robot.load(files[0]).names[0], "tool_std_x"} <= set(pq.read_schema(out).names)
    assert list(tmp_path.iterdir()) == [out]


def test_tuning_on_a_wrong_model_helps_and_its_file_is_taken(tmp_path):
    recording, tuning = DATA / "arm2_square_mismatch", tmp_path / "tuning.yaml"
    files = recording / "robot.yaml", recording / "log.parquet"
    text = succeed("tune", *files, "--out", tuning)
    assert "log-likelihood" in text
    assert Noise.read(tuning) != Noise()
    for method, bound in (("ekf", 0.262), ("smoother", 0.21)):
        out = tmp_path / f"{method}.parquet"
        succeed("estimate", *files, "--out", out, "--with", method, "--tuning", tuning)
        assert Estimate.read(out).error_against(recording / "truth.parquet").tool_rms_centred <= bound


@pytest.fixture
def square(tmp_path, monkeypatch):
    """The first rows of a small arm's recording, in a folder to work in."""
    for name in ("robot.yaml", "robot.urdf"):
        shutil.copy(DATA / "arm2_square" / name, tmp_path)
    for name in ("log.parquet", "truth.parquet"):
        pq.write_table(pq.read_table(DATA / "arm2_square" / name).slice(0, 300), tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("method", ["map", "elastic-map"])
def test_the_most_probable_motion_and_its_loss_are_methods(square, method):
    plain = succeed(*estimate("--with", method, out="plain.parquet"))
    assert re.search(r"NIS [\d.]+ per reading", plain)
    succeed(*estimate("--with", method, "--loss", "student-t", out="robust.parquet"))
    robust = Estimate.read("robust.parquet")
    assert not np.array_equal(Estimate.read("plain.parquet").q, robust.q)
    assert robust.error_against("truth.parquet").tool_rms_centred < 0.1


def test_check_says_how_good_an_estimate_can_get(square):
    text = succeed("check", "robot.yaml", "log.parquet", "--bound")
    assert "Cramér–Rao bound" in text
    assert "tool [mm]" in text
    refuse("check", "robot.yaml", "--bound", words=["--bound is for a LOG"])


def test_a_declared_delay_reaches_the_kalman_methods(folder):
    edit("robot.yaml", "  noise_std: 0.05", "  noise_std: 0.05\n  delay: 0.001")
    for method in ("ekf", "smoother"):
        succeed(*estimate("--with", method, out=f"{method}.parquet"))
    assert not np.array_equal(Estimate.read("ekf.parquet").q, Estimate.read("smoother.parquet").q)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--with", "ekf", "--poles", "300"], ["--poles is not for --with ekf"]),
        (["--with", "smoother", "--bias"], ["--bias is not for --with smoother"]),
        (["--gate", "5"], ["--gate is not for --with observer"]),
        (["--with", "ekf", "--tuning", "none.yaml"], ["none.yaml", "no such file"]),
        (["--with", "ekf", "--tuning", "robot.yaml"], ["robot.yaml:1", "urdf"]),
        (["--with", "ekf", "--gate", "-1"], ["gate is -1"]),
    ],
)
def test_options_that_do_not_fit_a_method_are_refused(folder, arguments, words):
    refuse(*estimate(*arguments), words=words)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--out", "tuning.txt"], ["tuning.txt", ".yaml"]),
        (["--out", "robot.yaml"], ["robot.yaml", "written over"]),
        (["--out", "tuning.yaml", "--free", "speed"], ["'speed' is not one of"]),
        (["--out", "gone/tuning.yaml"], ["no directory"]),
    ],
)
def test_tuning_that_cannot_be_is_refused(folder, arguments, words):
    refuse("tune", "robot.yaml", "log.parquet", *arguments, words=words)


@pytest.mark.parametrize(
    ("arguments", "settings"),
    [
        (["--poles", "300"], {"poles": 300.0}),
        (["--poles", "bessel:200"], {"poles": poles.bessel(200)}),
        (["--poles", "butterworth:2e2"], {"poles": poles.butterworth(200)}),
        (["--poles", "damped:250", "--with", "observer"], {}),
        (["--bias"], {"bias": True}),
        (["--form", "predictor"], {"form": "predictor"}),
    ],
)
def test_options_reach_the_observer(folder, arguments, settings):
    robot = Robot.load("robot.yaml")
    expected = AccelerationObserver(robot, **settings).run(Log.read("log.parquet", robot))
    succeed(*estimate(*arguments))
    np.testing.assert_array_equal(Estimate.read("out.parquet").q, expected.q)


def test_csv_in_and_out(folder):
    pa.csv.write_csv(pq.read_table("log.parquet"), "log.csv")
    succeed(*estimate(log="log.csv", out="out.csv"))
    assert len(Estimate.read("out.csv")) == 2000


def test_an_estimate_is_written_over_an_older_one(folder):
    Path("out.parquet").write_text("old")
    succeed(*estimate())
    assert len(Estimate.read("out.parquet")) == 2000


def test_bridged_samples_are_counted_in_words(folder):
    alter("acc_link4_x", put(slice(500, 510), np.nan))
    text = succeed(*estimate())
    assert "1990 good" in text
    assert "10 bridged over missing samples" in text


def test_several_logs_go_to_a_directory_or_by_a_pattern(folder):
    for name in ("first.parquet", "second.v2.parquet"):
        shutil.copy("log.parquet", name)
    logs = ("estimate", "robot.yaml", "first.parquet", "second.v2.parquet", "--out")
    truths = ("--truth", "truth.parquet", "--truth", "truth.parquet")
    assert succeed(*logs, "new", *truths).count("offset out") == 4
    assert sorted(os.listdir("new")) == ["first.estimate.parquet", "second.v2.estimate.parquet"]
    succeed(*logs, "{stem}.csv")
    assert Path("second.v2.csv").is_file()
    succeed("estimate", "robot.yaml", "first.parquet", "--out", "new")


def test_one_bad_log_does_not_keep_the_others_waiting(folder):
    shutil.copy("log.parquet", "good.parquet")
    alter("tau_a2", put(7, np.inf))
    result = linkside("estimate", "robot.yaml", "log.parquet", "good.parquet", "--out", "new")
    assert result.exit_code == 1
    first, last = result.stderr.splitlines()
    assert "log.parquet" in first
    assert "row 7" in first
    assert "1 of 2 logs" in last
    assert os.listdir("new") == ["good.estimate.parquet"]


@pytest.fixture
def batch(folder):
    """Three logs, and what estimates them."""
    for name in ("a", "b", "c"):
        shutil.copy("log.parquet", f"{name}.parquet")
    return ("estimate", "robot.yaml", "a.parquet", "b.parquet", "c.parquet", "--out", "new")


@pytest.mark.parametrize("method", ["observer", "smoother"])
def test_logs_at_a_time_give_the_same_bytes(batch, method):
    succeed(*batch, "-j", "1", "--with", method)
    serial = [path.read_bytes() for path in sorted(Path("new").iterdir())]
    shutil.rmtree("new")
    succeed(*batch, "-j", "3", "--with", method)
    assert [path.read_bytes() for path in sorted(Path("new").iterdir())] == serial


def test_a_table_ends_a_batch_the_worst_first(batch):
    alter("tau_a2", put(7, np.inf), "b.parquet")
    result = linkside(*batch)
    assert result.exit_code == 1
    rows = [line for line in result.stdout.splitlines() if "│" in line][-3:]
    assert "b.parquet" in rows[0]
    assert "not estimated" in rows[0]
    assert all("believable" in row for row in rows[1:])


def test_estimates_made_from_the_same_are_left_alone(batch):
    succeed(*batch)
    Path("new/b.estimate.parquet").unlink()
    alter("tau_a2", put(7, 1.0), "c.parquet")
    text = succeed(*batch, "--skip-existing")
    assert re.findall(r"(\w)\.estimate\.parquet: up to date", text) == ["a"]
    assert len(Estimate.read("new/b.estimate.parquet")) == 2000
    assert succeed(*batch, "--skip-existing").count(": up to date") == 3
    edit("robot.yaml", "damping: 180.0", "damping: 181.0")
    assert succeed(*batch, "--skip-existing").count(": up to date") == 0
    assert succeed(*batch, "--skip-existing", "--poles", "200").count(": up to date") == 0
    refuse(*estimate("--skip-existing", out="out.csv"), words=["out.csv", "only Parquet estimates"])


def test_an_estimate_that_is_left_alone_is_no_better_for_it(batch):
    alter("acc_link4_z", lambda values: np.where(np.arange(len(values)) >= 900, -values, values), "b.parquet")
    strict = (*batch, "--with", "ekf", "--no-check", "--skip-existing", "--strict")
    assert linkside(*strict).exit_code == 3
    again = linkside(*strict)
    assert again.exit_code == 3
    assert again.stdout.count(": up to date") == 3
    assert "up to date, contradicted" in again.stdout


def test_an_estimate_that_is_left_alone_is_judged_by_all_its_readings(batch):
    """Its NIS, findings and verdict are those of when it was made."""
    Path("noise.yaml").write_text("acceleration: 0.035\n")
    told = (*batch, "--with", "ekf", "--tuning", "noise.yaml", "--skip-existing", "--json")
    first = [json.loads(line) for line in linkside(*told).stdout.splitlines()]
    again = [json.loads(line) for line in linkside(*told).stdout.splitlines()]
    assert all(one["up_to_date"] for one in again)
    for one, other in zip(sorted(first, key=itemgetter("log")), sorted(again, key=itemgetter("log")), strict=True):
        assert one["nis"] == pytest.approx(other["nis"], rel=1e-9)
        different = ("nis", "seconds", "up_to_date")
        assert {k: v for k, v in one.items() if k not in different} == {k: other[k] for k in one if k not in different}
    assert not any(one["believable"] for one in again)


def test_an_estimate_without_its_outcome_is_made_anew(batch):
    succeed(*batch)
    path = Path("new/a.estimate.parquet")
    table = pq.read_table(path)
    made_from = {key: value for key, value in pq.read_metadata(path).metadata.items() if key == b"linkside.made_from"}
    pq.write_table(table.replace_schema_metadata(made_from), path)
    assert succeed(*batch, "--skip-existing").count(": up to date") == 2


def test_a_batch_speaks_json_or_not_at_all(batch):
    alter("tau_a2", put(7, np.inf), "b.parquet")
    told = {one["log"]: one for one in map(json.loads, linkside(*batch, "--json").stdout.splitlines())}
    assert "row 7" in told["b.parquet"]["error"]
    assert told["a.parquet"]["rows"] == 2000
    assert told["a.parquet"]["status"] == {"good": 2000}
    assert told["a.parquet"]["believable"]
    quiet = linkside(*batch, "--quiet")
    assert (quiet.stdout, quiet.exit_code) == ("", 1)


def test_ctrl_c_ends_a_batch_in_the_middle_of_its_kernels(batch):
    command = [sys.executable, "-m", "linkside", *batch, "--with", "particle", "--particles", "5000", "-j", "2"]
    run = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, preexec_fn=_heed_ctrl_c)
    while not list(Path("new").glob(".*")) and run.poll() is None:
        time.sleep(0.05)
    time.sleep(0.3)
    run.send_signal(signal.SIGINT)
    assert run.communicate(timeout=60)[1].strip() == "linkside: interrupted"
    assert run.returncode == 130
    assert not Path("new").exists()


def _heed_ctrl_c():
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.mark.parametrize(
    ("logs", "out", "words"),
    [
        (["log.parquet", "sub/log.parquet"], "new", "output of two logs"),
        (["log.parquet", "sub/log.parquet"], "new.parquet", "name a directory"),
        (["log.parquet", "missing.parquet"], "new", "no such file"),
        (["log.parquet", "robot.yaml"], "new", "robot.yaml: a file that ends in"),
    ],
)
def test_several_logs_that_cannot_be(folder, logs, out, words):
    Path("sub").mkdir()
    shutil.copy("log.parquet", "sub")
    refuse("estimate", "robot.yaml", *logs, "--out", out, words=[words])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("damping: 180.0", "dampng: 180.0", ["robot.yaml:6", "dampng", "unknown key"]),
        ("stiffness: 240000.0", "stiffness: stiff", ["robot.yaml:5", "joints[0].stiffness", "a number"]),
        ("stiffness: 240000.0", "stiffness: 0", ["robot.yaml:5", "joints[0].stiffness"]),
        ("motor_inertia: 22.0", "motor_inertia: -22", ["robot.yaml:7", "joints[0].motor_inertia"]),
        ("- name: a3", "- name: b3", ["robot.yaml:16", "joints[2].name", "b3"]),
        ("link: link4", "link: link44", ["robot.yaml:27", "accelerometers[0].link", "link44"]),
        ("noise_std: 0.05", "axes: xy", ["robot.yaml", "3 elastic joints", "2 accelerations"]),
        ("urdf: robot.urdf", "urdf: other.urdf", ["robot.yaml:1", "urdf", "other.urdf"]),
        ("joints:", "joints: [", ["robot.yaml", "not valid YAML"]),
    ],
)
def test_a_robot_that_cannot_be(folder, old, new, words):
    edit("robot.yaml", old, new)
    refuse(*estimate(), words=words)


def test_a_urdf_that_cannot_be(folder):
    edit("robot.urdf", 'ixx="4.0"', 'ixx="-4.0"')
    refuse(*estimate(), words=["robot.urdf", "link1"])
    edit("robot.urdf", "<robot", "<robot <")
    refuse(*estimate(), words=["robot.urdf", "not valid XML"])


@pytest.mark.parametrize(
    ("column", "change", "words"),
    [
        ("theta_a3", lambda values: None, ["theta_a3", "missing"]),
        ("tau_a2", lambda values: None, ["tau_a2", "missing"]),
        ("acc_link4_y", lambda values: None, ["acc_link4_y", "missing"]),
        ("t", lambda values: None, ["'t'", "missing"]),
        ("theta_a1", put(1234, np.inf), ["theta_a1", "infinite", "row 1234"]),
        ("acc_link4_z", put(1999, -np.inf), ["acc_link4_z", "infinite", "row 1999"]),
        ("t", put(1500, 0.0), ["'t'", "backwards", "row 1500"]),
        ("t", put(1999, 1.5), ["'t'", "gap", "row 1999"]),
        ("t", put(3, np.nan), ["'t'", "nan", "row 3"]),
        ("tau_a1", lambda values: values.astype(str), ["tau_a1", "numbers are expected"]),
        ("acc_link4_x", put(slice(1000, 1200), np.nan), ["t = 0.5", "missing for more than"]),
        ("theta_a1", put(0, np.nan), ["row 0"]),
    ],
)
@pytest.mark.parametrize("rows", [300, 8192])
def test_a_recording_that_cannot_be(folder, monkeypatch, column, change, words, rows):
    monkeypatch.setattr(estimating, "ROWS", rows)
    alter(column, change)
    refuse(*estimate(), words=["log.parquet", *words])


def test_what_is_wrong_with_a_recording_is_said_before_it_is_believed(folder):
    alter("t", lambda t: 1e3 * t)
    alter("acc_link4_x", lambda x: np.where(np.arange(len(x)) >= 900, x[900], x))
    result = linkside(*estimate())
    assert result.exit_code == 0
    warned = result.stderr.splitlines()
    assert [line.partition("column ")[2].split(" at row")[0].split(";")[0] for line in warned] == [
        "'t' is in milliseconds (steps of 0.5)",
        "'acc_link4_x' is stuck at -8.68851 for 1100 rows",
    ]
    assert all(line.startswith("linkside: warning: log.parquet: ") for line in warned)
    listed = linkside("check", "robot.yaml", "log.parquet")
    assert listed.exit_code == 0
    assert re.search(r"channels that stay +suspicious: column 'acc_link4_x' is stuck", listed.stdout)
    assert re.search(r"motor torques +good", listed.stdout)


def test_a_recording_in_degrees_is_refused_and_check_lists_why(folder):
    for joint in ("a1", "a2", "a3", "a4", "a5", "a6"):
        alter(f"theta_{joint}", np.degrees)
    refuse(*estimate(), words=["'theta_a3' is in degrees", "convert it to radians"])
    listed = linkside("check", "robot.yaml", "log.parquet")
    assert listed.exit_code == 2
    assert re.search(r"units of positions +refused: column 'theta_a3' is in degrees", listed.stdout)


def test_a_recording_that_makes_numbers_overflow_names_log_and_sample(folder):
    alter("tau_a1", put(1500, 1e308))
    refuse(*estimate(), words=["log.parquet", "'tau_a1' is 1e+308", "row 1500"])
    refuse(*estimate(), "--no-check", words=["log.parquet", "sample 150"])


def test_files_that_are_no_recordings(folder):
    refuse(*estimate(log="missing.parquet"), words=["missing.parquet: no such file"])
    Path("short.parquet").write_bytes(Path("log.parquet").read_bytes()[:100_000])
    refuse(*estimate(log="short.parquet"), words=["short.parquet"])
    Path("text.csv").write_text("t,theta_a1\n0,zero\n")
    refuse(*estimate(log="text.csv"), words=["text.csv", "theta_a2"])
    refuse(*estimate(log="."), words=["."])
    refuse("estimate", "missing.yaml", "log.parquet", "--out", "out.parquet", words=["missing.yaml"])


def test_text_in_a_csv_names_column_and_row(folder):
    pa.csv.write_csv(pq.read_table("log.parquet"), "log.csv")
    lines = Path("log.csv").read_text().splitlines()
    lines[900] = lines[900].replace(lines[900].split(",")[0], "soon", 1)
    Path("log.csv").write_text("\n".join(lines))
    refuse(*estimate(log="log.csv"), words=["log.csv", "'t'", "'soon' at row 899"])


@pytest.mark.parametrize(
    ("out", "words"),
    [
        ("nowhere/out.parquet", "nowhere"),
        ("out.txt", ".parquet or .csv"),
        ("log.parquet", "written over what is read"),
        ("sub/../log.parquet", "written over what is read"),
        ("truth.parquet", "written over what is read"),
        ("sub/way.parquet/x.parquet", "way.parquet"),
        ("x" * 300 + ".parquet", "x.parquet"),
    ],
)
def test_outputs_that_cannot_be_are_refused_before_any_work(folder, monkeypatch, out, words):
    monkeypatch.setattr(Log, "stream", None)
    Path("sub").mkdir()
    Path("sub/way.parquet").touch()
    refuse(*estimate("--truth", "truth.parquet", out=out), words=[words])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--poles", "fast"], ["--poles", "'fast'"]),
        (["--poles", "chebyshev:250"], ["--poles", "damped, bessel, butterworth"]),
        (["--poles", "-3"], ["--poles", "positive"]),
        (["--poles", "nan"], ["--poles", "positive"]),
        (["--poles", "1e5"], ["too fast"]),
        (["--with", "magic"], ["--with", "observer"]),
        (["--form", "magic"], ["--form", "predictor"]),
        (["--speed", "3"], ["--speed"]),
        (["--truth", "truth.parquet", "--truth", "truth.parquet"], ["--truth", "2 times", "1 logs"]),
        (["--truth", "missing.parquet"], ["missing.parquet"]),
        (["--truth", "log.parquet"], ["log.parquet", "not an estimate"]),
    ],
)
def test_options_that_cannot_be(folder, arguments, words):
    refuse(*estimate(*arguments), words=words)


def test_a_truth_of_another_time_leaves_no_estimate(folder):
    alter("t", lambda t: t + 100, "truth.parquet")
    refuse(*estimate("--truth", "truth.parquet"), words=["truth.parquet", "times differ"])


def test_without_arguments_there_is_help():
    assert "Commands:" in succeed()
    assert "observer" in succeed("estimate", "--help")
    refuse("estimate", words=["ROBOT"])
    refuse("guess", words=["guess"])


def test_the_version_is_that_of_the_package():
    from importlib.metadata import version

    assert succeed("--version") == f"linkside, version {version('linkside')}\n"


def test_debug_shows_where_an_error_comes_from(folder):
    result = linkside("--debug", *estimate(log="missing.parquet"))
    assert result.exit_code == 2
    assert "Traceback" in result.stderr
    assert result.stderr.splitlines()[-1].startswith("linkside: missing.parquet")


def test_disks_that_fill_up_leave_nothing(folder, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq.ParquetWriter, "write_table", full)
    refuse(*estimate(), words=["out.parquet", "No space left on device"])


def interrupting(act):
    """A method that is interrupted after its first piece."""

    def build(robot, options):
        def run(pieces):
            for number, estimate in enumerate(AccelerationObserver(robot).run_pieces(pieces)):
                if number:
                    act()
                yield estimate

        return run

    return methods.Method("", (), build)


def raise_interrupt():
    raise KeyboardInterrupt


@pytest.mark.parametrize("out", ["out.parquet", "new"])
def test_an_interrupt_leaves_nothing(folder, monkeypatch, out):
    monkeypatch.setitem(estimating.METHODS, "observer", interrupting(raise_interrupt))
    monkeypatch.setattr(estimating, "ROWS", 500)
    shutil.copy("log.parquet", "second.parquet")
    before = sorted(folder.rglob("*"))
    result = linkside(*estimate(out=out), *(["second.parquet"] if out == "new" else []))
    assert result.exit_code == 130
    assert result.stderr.strip() == "linkside: interrupted"
    assert sorted(folder.rglob("*")) == before


def test_a_batch_is_not_stopped_between_a_file_and_its_cleanup(folder, monkeypatch):
    """The first log is interrupted while the second has made its file and not yet taken note of it."""
    opened, second = threading.Event(), threading.Event()

    def open_slowly(path):
        part = parts.open_part(path)
        if "second" in path.name:
            second.set()
            for _ in range(200):  # many places where an exception from outside would be raised
                time.sleep(0.001)
            opened.set()
        return part

    def interrupt():
        second.wait(10)
        raise KeyboardInterrupt

    monkeypatch.setattr(writer, "open_part", open_slowly)
    monkeypatch.setitem(estimating.METHODS, "observer", interrupting(interrupt))
    monkeypatch.setattr(estimating, "ROWS", 500)
    shutil.copy("log.parquet", "second.parquet")
    before = sorted(folder.rglob("*"))
    assert linkside(*estimate("-j", "2", out="new"), "second.parquet").exit_code == 130
    assert opened.is_set()
    assert sorted(folder.rglob("*")) == before


def test_a_job_that_is_ended_leaves_nothing(folder, monkeypatch):
    monkeypatch.setitem(estimating.METHODS, "observer", interrupting(lambda: os.kill(os.getpid(), signal.SIGTERM)))
    monkeypatch.setattr(estimating, "ROWS", 500)
    before = sorted(folder.rglob("*"))
    assert linkside(*estimate()).exit_code == 143
    assert sorted(folder.rglob("*")) == before


def test_a_real_process_says_the_same(folder):
    arguments = (*estimate(log="missing.parquet"),)
    done = subprocess.run([sys.executable, "-m", "linkside", *arguments], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "linkside: missing.parquet: no such file\n"


def test_a_terminal_in_ascii_is_no_error(folder):
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "MPLCONFIGDIR": str(folder)}
    for arguments in (estimate("--truth", "truth.parquet"), ("check", "robot.yaml")):
        command = [sys.executable, "-m", "linkside", *arguments]
        done = subprocess.run(command, capture_output=True, env=environment)
        assert (done.returncode, done.stderr) == (0, b"")


class Terminal(list):
    """Standard error as a terminal."""

    encoding = "utf-8"

    def isatty(self):
        return True

    def write(self, text):
        self.append(text)

    def flush(self):
        pass


@pytest.mark.parametrize(("delay", "shown"), [(0.0, True), (60.0, False)])
def test_a_bar_appears_only_when_work_takes_long(monkeypatch, delay, shown):
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(terminal, "DELAY", delay)
    with terminal.bar(100) as advance:
        time.sleep(0.01)
        advance("log.parquet", 40)
        time.sleep(0.2)
        advance("log.parquet", 60)
    assert ("log.parquet" in "".join(screen)) == shown


def test_check_tells_words_tables_and_draws(folder):
    text = succeed("check", "robot.yaml", "log.parquet", "--figure", "check.png")
    for words in ("a1 alone", "a2 against a3", "log: worst", "figure: check.png", "t = "):
        assert words in text
    assert Path("check.png").read_bytes().startswith(b"\x89PNG")
    assert "log: worst" not in succeed("check", "robot.yaml")


def test_check_says_that_a_robot_has_too_few_axes(folder):
    edit("robot.yaml", "noise_std: 0.05", "axes: xy")
    assert "Too few axes: 2" in succeed("check", "robot.yaml", "--figure", "words.svg")


def test_check_and_demo_refuse_what_cannot_be(folder):
    refuse("check", "missing.yaml", words=["missing.yaml"])
    refuse("check", "robot.yaml", "missing.parquet", words=["missing.parquet"])
    refuse("check", "robot.yaml", "--figure", "check.gif", words=["check.gif", ".png"])
    refuse("check", "robot.yaml", "--figure", "nowhere/check.png", words=["nowhere/check.png"])
    Path("way.png").mkdir()
    refuse("demo", "--figure", "way.png", words=["way.png"])
    alter("theta_a1", put(99, np.inf))
    refuse("check", "robot.yaml", "log.parquet", "--figure", "check.png", words=["log.parquet", "row 99"])


def test_demo_shows_how_much_closer_the_observer_comes(folder):
    text = succeed("demo")
    motors, observer = (next(line for line in text.splitlines() if name in line) for name in ("motors", "observer"))
    assert "5.5817" in motors
    assert float(re.findall(r"[\d.]+", observer)[2]) <= 0.065
    assert Path("linkside-demo.png").stat().st_size > 20_000
    assert "linkside estimate" in text
    assert "linkside check" in text
    assert "figure: mine.pdf" in succeed("demo", "--figure", "mine.pdf")
