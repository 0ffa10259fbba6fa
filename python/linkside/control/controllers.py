"""Controllers for simulations: `JointPD`, `SimpleAdaptive`, or any function ``(t, state) -> tau``.

`feedback.StateFeedback` is another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt

from linkside.arguments import per_joint
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.robot import Robot

AXES = "xyz"


class State(NamedTuple):
    """The state of the robot that a controller receives, (n,) each: true, measured or estimated.

    Attributes
    ----------
    q, dq
        Link positions [rad] and velocities [rad/s].
    theta, dtheta
        Motor positions and velocities, link side; those of the link where a joint is rigid.
    """

    q: FloatArray
    dq: FloatArray
    theta: FloatArray
    dtheta: FloatArray


@dataclass(frozen=True, eq=False)
class JointPD:
    """Proportional and derivative control of each motor, τ = τ₀ + K_p (θ_ref − θ) + K_d (θ̇_ref − θ̇).

    Attributes
    ----------
    kp, kd
        Gains, one number or one a joint [N m/rad, N m s/rad].
    times : (K,)
        Knots of the reference [s]; straight between them, at rest before and after.
    theta : (K, n)
        Motor positions at the knots [rad].
    tau
        Constant torque τ₀, one number or one a joint [N m].
    """

    kp: npt.ArrayLike
    kd: npt.ArrayLike
    times: npt.ArrayLike
    theta: npt.ArrayLike
    tau: npt.ArrayLike = 0.0

    def law(self, robot: Robot) -> dict[str, Any]:
        """Describe the controller to the core."""
        gains = {name: per_joint(name, getattr(self, name), robot.n).tolist() for name in ("kp", "kd", "tau")}
        return {"reference": knots(self.times, self.theta, robot.n, "theta"), **gains}


@dataclass(frozen=True, eq=False)
class SimpleAdaptive:
    """Direct adaptive control of the tool's position by the transposed Jacobian, with damping of the joints.

    τ = Jᵀ(K_p e + K_d ė) + K_v (q̇ − θ̇), e being the tool's distance to a reference model of second order that
    follows the command. The gains of each axis adapt: K_p = Γ_pp e² + K_pi with K̇_pi = Γ_pi e² − σ_p K_pi, K_d
    likewise with ė. They begin at zero.

    This is a reconstruction. Ulrich and Sasiadek, "Extended Kalman filtering for flexible joint space robot control",
    ACC 2011, give the numbers, which are the defaults here, and refer for the equations to Ulrich, Sasiadek and
    Barkana, JGCD 35(3), 2012, which was not at hand; bandwidth and damping ratio of the model are ours.

    Attributes
    ----------
    times : (K,)
        Knots of the command [s]; straight between them, at rest before and after.
    command : (K, axes)
        Commanded position of the tool at the knots, in the base frame [m].
    axes
        Coordinates of the tool that are controlled, such as ``"xy"``.
    position, velocity
        (Γ_pp, Γ_pi) and (Γ_dp, Γ_di).
    leakage
        (σ_p, σ_d) [1/s].
    joint_damping
        K_v [N m s/rad].
    bandwidth, damping_ratio
        ω_n [rad/s] and ζ of the reference model.
    """

    times: npt.ArrayLike
    command: npt.ArrayLike
    axes: str = "xyz"
    position: tuple[float, float] = (150.0, 150.0)
    velocity: tuple[float, float] = (25.0, 25.0)
    leakage: tuple[float, float] = (0.008, 0.023)
    joint_damping: float = 35.0
    bandwidth: float = 5.0
    damping_ratio: float = 0.9

    def law(self, robot: Robot) -> dict[str, Any]:
        """Describe the controller to the core."""
        del robot
        if not self.axes or any(axis not in AXES for axis in self.axes) or len(set(self.axes)) < len(self.axes):
            raise EstimatorError(f"axes is {self.axes!r}, expected some of 'xyz', each once")
        names = ("position", "velocity", "leakage", "joint_damping", "bandwidth", "damping_ratio")
        return {
            "command": knots(self.times, self.command, len(self.axes), "command"),
            "coordinates": [AXES.index(axis) for axis in self.axes],
            **{name: getattr(self, name) for name in names},
        }


@runtime_checkable
class CoreController(Protocol):
    """A controller whose law the core has, such as `JointPD` and `feedback.StateFeedback`."""

    def law(self, robot: Robot) -> dict[str, Any]:
        """Describe the controller to the core."""


Controller: TypeAlias = CoreController | Callable[[float, State], Sequence[float] | FloatArray]


def law_of(controller: Controller, robot: Robot) -> Any:
    """Describe any controller to the core, a function as one of plain arrays."""
    if isinstance(controller, CoreController):
        return controller.law(robot)
    if not callable(controller):
        kind = type(controller).__name__
        raise EstimatorError(
            f"controller is a {kind}, expected JointPD, SimpleAdaptive, StateFeedback or a function (t, state) -> tau"
        )
    function = controller

    def law(t: float, *arrays: FloatArray) -> FloatArray:
        return np.ascontiguousarray(function(t, State(*arrays)), dtype=np.float64)

    return law


def knots(times: npt.ArrayLike, values: npt.ArrayLike, width: int, name: str) -> dict[str, Any]:
    """Describe a path to the core: one row of ``width`` values a time."""
    t, rows = np.asarray(times, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if t.ndim != 1 or rows.shape != (len(t), width):
        raise EstimatorError(f"{name} has shape {rows.shape}, expected (knots, {width}) beside times (knots,)")
    return {"times": t.tolist(), "values": rows.ravel().tolist(), "width": width}
