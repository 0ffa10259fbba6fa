"""Friction elements beside a spring, calibrated: their motion by SciPy, their derivatives by differences."""

import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy.integrate import solve_ivp

from linkside import Log, Robot
from linkside._core import Response
from linkside.calibration import calibrate

from .test_calibration import ARM, INERTIA
from .test_response import PERIOD, made_up, smooth_motion, tree

STIFFNESS, DAMPING, ROWS = 4e3, 4.0, 2000
ELEMENTS = {
    "dahl": {"stiffness": 2e3, "limit": 2.0, "law": "dahl"},
    "bouc-wen": {"stiffness": 2e3, "limit": 2.0, "law": "bouc-wen", "beta": 0.7},
    "slip": {"stiffness": 1.5e3, "limit": 1.5, "law": "slip", "rounding": 0.3},
}
WAVES = ((0.1, 7.0), (0.05, 17.0), (0.01, 41.0))


def giving(element, u):
    """How much of its torsion an element follows, at u = z/w along its way: as docs/transmissions.md has the laws."""
    if element["law"] == "slip":
        return min(1.0, (1 - u) / element["rounding"])
    recoil = 2 * element.get("beta", 1.0) - 1
    return min(1 - recoil * u, 1 - u)


def motors(t):
    """Along sines that start from rest at zero."""
    return [sum(size * w**k * wave(w * t) for size, w in WAVES) for k, wave in enumerate((vers, np.sin, np.cos))]


def vers(x):
    return 1 - np.cos(x)


def moved(element, t):
    """q, q̇ and q̈ of the arm behind spring, damper and element."""

    def rates(t, state):
        q, dq, z = state
        theta, dtheta, _ = motors(t)
        way = np.sign(dtheta - dq)
        torque = STIFFNESS * (theta - q) + DAMPING * (dtheta - dq) + element["stiffness"] * z
        u = way * z * element["stiffness"] / element["limit"]
        return [dq, torque / INERTIA, (dtheta - dq) * giving(element, u)]

    found = solve_ivp(rates, (0, t[-1]), [0.0, 0.0, 0.0], t_eval=t, rtol=1e-7, atol=1e-10, max_step=2e-3)
    return found.y[0], found.y[1], np.array([rates(*row)[1] for row in zip(t, found.y.T, strict=True)])


def arm(folder, element, share=1.0):
    """The arm, spring and element off by a factor; from robot.yaml."""
    off = {key: element[key] * share for key in ("stiffness", "limit")}
    joint = {"name": "j", "stiffness": STIFFNESS * share, "damping": DAMPING, "motor_inertia": 1.0}
    sensor = {"name": "a", "link": "arm", "xyz": [0.5, 0, 0], "axes": "xy", "noise_std": 0.02}
    settings = {"urdf": "arm.urdf", "joints": [joint | {"hysteresis": [element | off]}], "accelerometers": [sensor]}
    (folder / "arm.urdf").write_text(ARM)
    with open(folder / "robot.yaml", "w") as file:
        YAML().dump(settings | {"encoder": {"resolution": 1e-6}}, file)
    return Robot.load(folder / "robot.yaml")


@pytest.mark.parametrize("law", ELEMENTS)
def test_a_link_moves_as_its_element_lets_it(law, tmp_path):
    element, t = ELEMENTS[law], PERIOD * np.arange(400)
    q, *_ = moved(element, t)
    motion = smooth_motion(t, np.asarray(motors(t)[0])[:, None])
    found, _ = Response(arm(tmp_path, element).core, motion, kinds=["q"], fixed=[]).evaluate([], [], [0.0, 0.0])
    without = np.abs(q - motors(t)[0]).max()
    assert np.abs(found[:, 0] - q).max() < 2e-3 * without


@pytest.mark.parametrize("law", ELEMENTS)
def test_spring_and_element_are_told_apart(law, tmp_path):
    element, t = ELEMENTS[law], PERIOD * np.arange(ROWS)
    _, dq, ddq = moved(element, t)
    noise = np.random.default_rng(1).normal(0, 0.02, (2, ROWS))
    robot = arm(tmp_path, element, 1.3)
    columns = {"t": t, "theta_j": np.round(motors(t)[0] * 1e6) / 1e6}
    log = Log.from_table(columns | {"a_x": noise[0] - 0.5 * dq**2, "a_y": noise[1] + 0.5 * ddq}, robot)
    found = calibrate(robot, log, ["stiffness", "damping", "hysteresis_stiffness", "hysteresis_limit"])
    assert found.accepted
    truth = {"stiffness_j": STIFFNESS, "damping_j": DAMPING}
    truth |= {f"hysteresis_{key}_j": element[key] for key in ("stiffness", "limit")}
    assert {e.parameter.name for e in found.estimates} == set(truth)
    for e in found.estimates:
        assert abs(e.value - truth[e.parameter.name]) < 3 * e.std
        assert e.std < 0.1 * truth[e.parameter.name]
    found.write(tmp_path / "robot.yaml", tmp_path / "new.yaml")
    (written,) = Robot.load(tmp_path / "new.yaml").drives[0].hysteresis
    assert written.stiffness == pytest.approx(found["hysteresis_stiffness_j"].value, rel=0.01)
    assert written.limit == pytest.approx(found["hysteresis_limit_j"].value, rel=0.01)


def test_derivatives_are_those_of_the_steps():
    """Of elements that have been turned back, in two of three joints that move each other."""
    elements = [{"stiffness": 1e3, "limit": 0.5}, {"stiffness": 5e2, "limit": 0.2, "law": "slip", "rounding": 0.5}]
    robot, model = tree(5, hysteresis=elements)
    t, *_, theta = made_up(robot, model, rows=80)
    free = [("stiffness", 0, 0), ("damping", 1, 0)]
    free += [(f"hysteresis_{key}", j, i) for key in ("stiffness", "limit") for j, i in ((0, 0), (1, 1))]
    response = Response(robot.core, smooth_motion(t, theta), kinds=["acceleration", "q", "torque"], fixed=[])
    at = np.array([3e3, 5.0, 1.1e3, 4e2, 0.6, 0.25, *1e-3 * np.arange(6)])

    def evaluate(x):
        return response.evaluate(free, x[: len(free)].tolist(), x[len(free) :].tolist())

    slopes = evaluate(at)[1]
    for i in range(len(at)):
        step = np.zeros(len(at))
        step[i] = 1e-4 * max(abs(at[i]), 1e-3)
        near, far = (evaluate(at + k * step)[0] - evaluate(at - k * step)[0] for k in (1, 2))
        expected = (8 * near - far) / (12 * step[i])
        assert np.abs(expected).max() > 1e-6
        assert np.abs(slopes[:, :, i] - expected).max() < 1e-5 * np.abs(expected).max()
