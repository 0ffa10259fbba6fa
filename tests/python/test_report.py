"""Reports: one file that fetches nothing, the verdict first, whatever the command and however long the recording."""

import re
import shutil
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

from linkside import cli, demo
from linkside.errors import OutputError
from linkside.recording.overview import Overview
from linkside.recording.overview_figures import residual_figures, status_figures, tool_figures, torsion_figures
from linkside.recording.trace import STRETCHES, Trace
from linkside.report import Page, Verdict, inputs
from linkside.report.page import LARGEST
from linkside.text import Titled

from . import gallery

DATA = Path(__file__).parents[1] / "data"
ARM = DATA / "arm2_square"
MISMATCH = DATA / "arm2_square_mismatch"
VOID = {"meta", "img", "br", "hr", "link", "input"}


class Reader(HTMLParser):
    """Follows a page: what is open, what is fetched, its texts by tag."""

    def __init__(self, text):
        super().__init__()
        self.open, self.addresses, self.ids, self.texts, self.order = [], [], [], {}, []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        told = dict(attributes)
        self.addresses += [value for key, value in attributes if key in ("src", "href", "xlink:href", "srcset", "data")]
        self.ids += [told["id"]] if "id" in told else []
        self.order.append((tag, told))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open, tag
        assert self.open.pop() == tag

    def handle_data(self, text):
        if self.open:
            self.texts.setdefault(self.open[-1], []).append(text)


def check(path):
    """Everything that holds of every report; gives its text and what was read."""
    text = path.read_text()
    read = Reader(text)
    assert read.open == []
    assert len(text.encode()) <= LARGEST
    assert not [a for a in read.addresses if not a.startswith(("#", "data:"))], "it would fetch something"
    assert not re.search(r"@import|url\((?!#)", text)
    assert len(read.ids) == len(set(read.ids)), "an id is there twice"
    for reference in (a[1:] for a in read.addresses if a.startswith("#")):
        assert reference in read.ids
    for svg in re.findall(r"<svg.*?</svg>", text, re.DOTALL):
        ET.fromstring(svg)
    first = next(index for index, (tag, told) in enumerate(read.order) if told.get("id") == "verdict")
    assert first < next(index for index, (tag, _) in enumerate(read.order) if tag == "h2")
    assert "viewport" in text
    assert "@media print" in text
    assert re.search(r"SHA-256 <code>[0-9a-f]{64}</code>", text)
    assert "linkside 0" in text
    return text, read


def run(*arguments, code=0):
    done = CliRunner().invoke(cli.main, [*map(str, arguments)])
    assert done.exit_code == code, done.output
    return done.output


@pytest.mark.parametrize(
    ("folder", "method", "level", "headline"),
    [
        (ARM, "ekf", "good", "No row, channel or finding contradicts this estimate"),
        (MISMATCH, "ekf", "good", "No row, channel or finding contradicts this estimate"),
        (ARM, "observer", "open", "Nothing was found that speaks against this estimate"),
    ],
)
def test_of_an_estimate(tmp_path, folder, method, level, headline):
    report = tmp_path / "report.html"
    robot, log, out = folder / "robot.yaml", folder / "log.parquet", tmp_path / "out.parquet"
    truth = ("--truth", folder / "truth.parquet")
    assert f"report: {report}" in run(
        "estimate", robot, log, "--with", method, "--out", out, "--report", report, *truth
    )
    text, read = check(report)
    assert f'class="verdict {level}"' in text
    assert read.texts["strong"] == [headline]
    assert {"Tool", "Springs", "Readings against the estimate", "Against the truth", "Made from"} <= set(
        read.texts["h2"]
    )
    assert ("What to do next" in read.texts["h2"]) == (level != "open")
    assert text.count("<svg") >= (6 if method == "ekf" else 5) - (method == "observer")
    for file in (robot, log, out, folder / "robot.urdf", folder / "truth.parquet"):
        assert str(file) in text
        assert inputs([("", file)])[0].sha256 in text


def slipped(path):
    """The arm's recording, an encoder 5 mrad off from row 500 on."""
    log = pd.read_parquet(ARM / "log.parquet")
    log.loc[500:, "theta_axis2"] += 5e-3
    log.to_parquet(path)


def test_of_an_estimate_that_readings_contradict(tmp_path):
    log, report = tmp_path / "log.parquet", tmp_path / "report.html"
    slipped(log)
    run("estimate", ARM / "robot.yaml", log, "--with", "ekf", "--out", tmp_path / "out.parquet", "--report", report)
    text, read = check(report)
    assert 'class="verdict bad"' in text
    assert read.texts["strong"] == ["Readings contradict this estimate"]
    assert "What to do next" in read.texts["h2"]


def test_of_a_batch(tmp_path):
    logs = [tmp_path / name for name in ("a.parquet", "b.parquet", "c.csv")]
    shutil.copy(ARM / "log.parquet", logs[0])
    slipped(logs[1])
    logs[2].write_text("t,nothing\n0,1\n")
    report = tmp_path / "report.html"
    run("estimate", ARM / "robot.yaml", *logs, "--with", "ekf", "--out", tmp_path / "out", "--report", report, code=1)
    text, read = check(report)
    assert read.texts["strong"] == ["1 of 3 estimates are without contradiction"]
    cells = [cell for cell in read.texts["td"] if cell.endswith((".parquet", ".csv"))]
    assert cells == [str(logs[2]), str(logs[1]), str(logs[0])], "the worst first"
    assert "column &#39;theta_axis2&#39; is missing" in text


def test_of_check_compare_and_tune(tmp_path):
    report = tmp_path / "report.html"
    wrong = pd.read_parquet(ARM / "log.parquet")
    wrong[[f"tool_acc_{axis}" for axis in "xyz"]] /= 9.80665
    wrong.to_parquet(tmp_path / "wrong.parquet")
    run("check", ARM / "robot.yaml", tmp_path / "wrong.parquet", "--report", report, code=2)
    text, read = check(report)
    assert 'class="verdict bad"' in text
    assert "sentinels" in read.texts["td"]
    assert "Multiply by 9.80665." in read.texts["li"]
    run("compare", demo.TRUTH, demo.TRUTH, "--names", "<b>same</b>", "--report", report)
    text, _ = check(report)
    assert "&lt;b&gt;same&lt;/b&gt;" in text
    short = tmp_path / "short.parquet"
    pd.read_parquet(ARM / "log.parquet").head(200).to_parquet(short)
    run("tune", ARM / "robot.yaml", short, "--out", tmp_path / "tuning.yaml", "--report", report)
    assert "Values" in check(report)[1].texts["h2"]


def test_refused_before_any_work(tmp_path):
    out = tmp_path / "out.parquet"
    arguments = ["estimate", ARM / "robot.yaml", ARM / "log.parquet", "--out", out, "--report"]
    run(*arguments, tmp_path / "report.pdf", code=2)
    run(*arguments, tmp_path / "nowhere/report.html", code=2)
    assert not out.exists()
    with pytest.raises(OutputError, match="html"):
        Page("x", Verdict("open", "y")).write(tmp_path / "page.txt")


@settings(max_examples=40)
@given(
    st.lists(st.integers(1, 900), min_size=1, max_size=8),
    st.integers(1, 3),
    st.integers(0, 2**32 - 1),
)
def test_traces_keep_extremes_and_means(sizes, width, seed):
    random = np.random.default_rng(seed)
    t = 1e-3 * np.arange(sum(sizes))
    values = random.standard_normal((len(t), width))
    values[random.random(values.shape) < 0.1] = np.nan
    trace = Trace()
    for rows in np.split(np.arange(len(t)), np.cumsum(sizes)[:-1]):
        trace.add(t[rows], values[rows])
    assert len(trace.t) <= 2 * STRETCHES + 1
    assert (np.diff(trace.t) > 0).all()
    np.testing.assert_array_equal(np.fmin.reduce(trace.low), np.fmin.reduce(values))
    np.testing.assert_array_equal(np.fmax.reduce(trace.high), np.fmax.reduce(values))
    np.testing.assert_array_equal(trace.largest, np.fmax.reduce(np.abs(values), initial=0.0))
    if len(t) <= 2 * STRETCHES:
        np.testing.assert_array_equal(trace.mean, values)
        np.testing.assert_allclose(trace.t, t)
    known = np.isfinite(trace.mean)
    assert (trace.low[known] <= trace.mean[known] + 1e-12).all()
    assert (trace.mean[known] <= trace.high[known] + 1e-12).all()


@pytest.mark.parametrize("name", gallery.BUILT)
def test_figures_of_every_robot(name):
    """One joint, a slide, seven joints with fifteen channels: all are drawn, and a page of them is small."""
    log, truth = gallery.recorded(name)
    view = Overview.of(gallery.robot(name), [(log, truth)])
    figures = [*tool_figures(view), *torsion_figures(view), *residual_figures(view, 0.0), *status_figures(view)]
    assert len(figures) >= 4
    html = Page("gallery", Verdict("open", name), sections=[("All", figures)]).to_html()
    assert len(html) < LARGEST
    assert html.count("<svg") == len(figures)


def test_a_page_of_too_much_is_drawn_in_points():
    random = np.random.default_rng(0)

    def heavy(number):
        figure = Figure(figsize=(5, 3))
        axes = figure.subplots()
        axes.scatter(*random.standard_normal((2, 2500)), s=3, gid=f"n{number}")
        return f"figure {number}", figure

    table = Titled("long", ("a", "b"))
    for row in range(3000):
        table.add_row(str(row), "x")
    parts = [heavy(number) for number in range(9)]
    html = Page("heavy", Verdict("open", "much"), sections=[("All", [*parts, table])]).to_html()
    assert len(html) < LARGEST
    assert html.count("<figure>") == 9
    assert "data:image/png" in html
    assert "2500 more rows are left out." in html
