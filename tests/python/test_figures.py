"""Figures hold on any robot: everything is within the paper, nothing lies over anything, every line is told apart."""

from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from linkside import ExtendedKalmanFilter, Robot
from linkside.calibration import figures as calibrated
from linkside.calibration.parameters import catalogue
from linkside.comparison import compare
from linkside.consistency import consistency
from linkside.demo.figure import demo_figure
from linkside.demo.run import run as demonstrate
from linkside.errors import EstimatorError
from linkside.excitation import expected_errors
from linkside.excitation.expected import motion_of
from linkside.excitation.figure import excitation_figure
from linkside.figures import line_style
from linkside.observability import analysis, candidates, check, figure, place
from linkside.observability.result import Observability, Posture, describe
from linkside.robot import workspace
from linkside.tuning.front_figure import front_figure

from .gallery import BUILT, recorded, robot

FEW = ("two joints", "long names, twelve channels")
"""Where a figure's other forms are drawn too."""

NAMES = [pytest.param(name, id=name) for name in BUILT]


@pytest.fixture(autouse=True)
def _few_postures(monkeypatch):
    monkeypatch.setattr(workspace, "SAMPLES", 1024)
    monkeypatch.setattr(figure, "CELLS", 16)
    monkeypatch.setattr(analysis, "_refine", unrefined)


def unrefined(report, start):
    """A posture as `check` has it, but not the very worst of its kind: the search takes seconds."""
    seen = Observability.of(report.robot, start[None])
    direction = seen.directions[0, -1]
    words = describe(report.joints, direction)
    return Posture(start, max(1e5, float(seen.worst[0])), float(seen.condition[0]), direction, words)


def boxes(artists, renderer):
    return [(artist, artist.get_window_extent(renderer)) for artist in artists if artist.get_visible()]


def holds(drawn):
    """Every text is within the paper; texts and legends do not overlap; legends hide no data; lines differ."""
    canvas = FigureCanvasAgg(drawn)
    canvas.draw()
    renderer, paper = canvas.get_renderer(), drawn.bbox
    words = [(t, b) for t, b in boxes(drawn.findobj(Text), renderer) if t.get_text().strip() and b.width > 0]
    words = [(t, b) for t, b in words if is_shown(t)]
    for text, box in words:
        inside = box.x0 > paper.x0 - 2 and box.x1 < paper.x1 + 2 and box.y0 > paper.y0 - 2 and box.y1 < paper.y1 + 2
        assert inside, f"{text.get_text()!r} leaves the paper"
    for (one, a), (other, b) in combinations(words, 2):
        overlap = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        assert min(overlap) < 3, f"{one.get_text()!r} lies over {other.get_text()!r}"
    legends = [axes.get_legend() for axes in drawn.axes if axes.get_legend()] + drawn.legends
    for legend in legends:
        box = legend.get_window_extent(renderer)
        for axes in drawn.axes:
            assert not box.padded(-2).overlaps(axes.get_window_extent()), f"a legend hides {axes.get_title()!r}"
    for axes in drawn.axes:
        named = [line for line in axes.lines if not line.get_label().startswith("_")]
        looks = [(line.get_color(), line.get_linestyle(), line.get_marker()) for line in named]
        assert len(set(looks)) == len(looks), f"two lines of {axes.get_title()!r} look the same"
    return drawn


def is_shown(text):
    """Whether a text is a label at a tick within the limits, or none of an axis."""
    axis = next((a for axes in text.figure.axes for a in (axes.xaxis, axes.yaxis) if text in ticks(a)), None)
    if axis is None:
        return True
    low, high = sorted(axis.get_view_interval())
    place = text.get_position()[0 if axis.axis_name == "x" else 1]
    return axis.axes.get_visible() and low <= place <= high


def ticks(axis):
    return [label for tick in (*axis.majorTicks, *axis.minorTicks) for label in (tick.label1, tick.label2)]


@pytest.mark.parametrize("name", NAMES)
def test_check(name):
    for log in (recorded(name)[0], None)[: 1 + (name in FEW)]:
        report = check(robot(name), log)
        drawn = holds(report.figure())
        legends = [axes.get_legend() for axes in drawn.axes if axes.get_legend()]
        assert any("lost" in text.get_text() for legend in legends for text in legend.get_texts())


@pytest.mark.parametrize("name", NAMES)
def test_excitation(name):
    log = recorded(name)[0]
    machine, before, after = robot(name), expected_errors(robot(name), []), expected_errors(robot(name), log)
    holds(excitation_figure(machine, motion_of(machine, log), before, after))


def test_a_map_is_cut_where_most_of_it_is_regular():
    """The middle of a UR10's workspace is singular for its wrist, whatever its shoulder does."""
    report = check(robot("long names, twelve channels"))
    pair = [report.robot.names.index(joint) for joint in ("shoulder_pan_joint", "shoulder_lift_joint")]
    sensors = [s for s in report.robot.accelerometers if s.link != "forearm_link"][1:]
    poor = check(Robot.from_pinocchio(report.robot.model, report.robot.config.joints, accelerometers=sensors))
    cut = figure.regular_cut(poor, pair, {})
    worst = [
        np.median(np.minimum(Observability.of(poor.robot, figure.spread(poor, pair, posture, 12)).worst, 1e12))
        for posture in (poor.home, cut)
    ]
    assert worst[1] <= worst[0]
    assert worst[1] < 100


def test_a_map_may_be_asked_for():
    report = check(robot("long names, twelve channels"))
    drawn = report.figure(over=("elbow_joint", "wrist_2_joint"), at={"wrist_1_joint": np.pi / 2})
    assert drawn.axes[0].get_xlabel() == "elbow_joint [°]"
    assert "wrist_1_joint = 90.0°" in drawn.axes[0].get_title().replace("\n", " ")
    for wrong in ({"over": ("elbow_joint",)}, {"over": ("elbow", "wrist_2_joint")}, {"at": {"elbow": 0.0}}):
        with pytest.raises(EstimatorError, match="elbow_joint"):
            report.figure(**wrong)


@pytest.mark.parametrize("name", NAMES)
def test_placement(name):
    machine = robot(name)
    links = [sensor.link for sensor in machine.accelerometers]
    found = place(machine, candidates(machine, links, reach=0.1, steps=2), recorded(name)[0].theta[::100].copy())
    drawn = holds(found.figure())
    labels = [text.get_text().split("\n")[0] for text in drawn.axes[1].get_yticklabels()]
    assert labels == list(dict.fromkeys(links))


@pytest.mark.parametrize("name", NAMES)
def test_consistency_and_comparison(name):
    log, truth = recorded(name)
    estimate = ExtendedKalmanFilter(robot(name), tolerances=False).run(log, innovations=True)
    for known in (truth, None)[: 1 + (name in FEW)]:
        drawn = holds(consistency(estimate, known).figure())
        lags = next(axes for axes in drawn.axes if axes.get_xlabel().startswith("lag"))
        assert {text.get_text() for text in lags.get_legend().get_texts()} >= set(estimate.channels)
    if name in FEW:
        holds(compare(truth, {"ekf": estimate, "smoother of the second repeat.parquet": estimate}).figure())


@pytest.mark.parametrize("name", NAMES)
def test_calibration(name):
    """Two estimates that ran away neither squeeze the others nor go unmarked."""
    machine, rng = robot(name), np.random.default_rng(2)
    parameters = [p for p in catalogue(machine, torque=False) if p.kind != "coupling"][:40]
    count = len(parameters)
    z = rng.standard_normal(count)
    z[:2] = 80.0, -40.0
    matrix = np.corrcoef(rng.standard_normal((count, 3 * count)))
    channels = ("theta_" + j for j in machine.names)
    fit = SimpleNamespace(autocorrelation=rng.standard_normal((50, machine.n + len(machine.acceleration_channels))))
    result = SimpleNamespace(
        estimates=[SimpleNamespace(parameter=p) for p in parameters],
        z=z,
        uncertainty=SimpleNamespace(std=np.full(count, 0.3)),
        correlation=matrix,
        problem=SimpleNamespace(channels=(*channels, *machine.acceleration_channels)),
        before=fit,
        after=fit,
    )
    drawn = holds(calibrated.estimates(result))
    low, high = drawn.axes[0].get_xlim()
    assert high - low < 15
    assert {t.get_text() for t in drawn.axes[0].texts} == {"80", "-40"}
    drawn = holds(calibrated.correlation(result))
    assert not [t for t in drawn.axes[0].get_yticklabels() if "noise" in t.get_text()]
    holds(calibrated.whiteness(result))


def test_demonstration_and_front():
    drawn = holds(demo_figure(demonstrate()))
    assert "less its mean" in drawn.axes[0].get_title()
    ratios = np.random.default_rng(3).uniform(0.5, 2, (30, 4))
    settings = ", ".join(f"poles_{name} 251.3" for name in robot("seven joints, fifteen channels").names)
    holds(front_figure(ratios, 4, settings))


def test_twenty_eight_lines_differ():
    assert len({tuple(line_style(index).values()) for index in range(28)}) == 28
