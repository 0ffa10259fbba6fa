"""Dynamics and sensors of a robot, for one state or for many."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkside import _core
from linkside.arguments import numbers
from linkside.errors import EstimatorError

from .sensors import FrameConfig

Array: TypeAlias = NDArray[np.float64]


class Dynamics(ABC):
    """What the kernels answer: they take one state, (n,), or a row for each sample, (T, n)."""

    core: _core.Robot

    @property
    @abstractmethod
    def n(self) -> int:
        """Number of joints."""

    @property
    @abstractmethod
    def tool(self) -> FrameConfig | None:
        """The tool centre point, if there is one."""

    @abstractmethod
    def require_masses(self, purpose: str, *, elastic_only: bool = False) -> None:
        """Require links with masses, for a method that needs them."""

    def inverse_dynamics(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, wrench: ArrayLike | None = None) -> Array:
        """Torque that transmissions give the links, M(q) q̈ + C(q, q̇) q̇ + g(q) less that of wrenches, (T, n) [N m].

        Constant wrenches of robot.yaml count; those that vary are `wrench`, (T, 6k), and none unless given.
        """
        torque = self._rows(self.core.inverse_dynamics, q=q, dq=dq, ddq=ddq)
        return torque if wrench is None else torque - self.wrench_torque(q, wrench)

    def wrench_torque(self, q: ArrayLike, wrench: ArrayLike) -> Array:
        """Torque that wrenches which vary give the joints, Jᵀ w, (T, n) [N m].

        `wrench`, (T, 6k): of each of the k wrenches of robot.yaml that are not constant, in their order, force along
        x, y and z [N] and moment about them [N m], in the axes of its frame.
        """
        jacobian, values = self.wrench_map(q), numbers("wrench", wrench)
        expected = (*jacobian.shape[:-2], jacobian.shape[-1])
        if values.shape != expected:
            raise EstimatorError(f"wrench: expected shape {expected}, got {values.shape}")
        return np.asarray((jacobian @ values[..., None])[..., 0])

    def wrench_map(self, q: ArrayLike) -> Array:
        """What each number of wrenches that vary adds to the joints' torques, (T, n, 6k): Jᵀ of `wrench_torque`."""
        return self._rows(self.core.wrench_map, q=q)

    def inverse_dynamics_derivatives(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> tuple[Array, Array, Array]:
        """Derivatives of `inverse_dynamics` by q, q̇ and q̈ (the last: mass matrix), three of (T, n, n)."""
        stacked = self._rows(self.core.inverse_dynamics_derivatives, q=q, dq=dq, ddq=ddq)
        by_q, by_dq, mass = stacked if stacked.ndim == 3 else np.moveaxis(stacked, 1, 0)
        return by_q, by_dq, mass

    def forward_dynamics(
        self, q: ArrayLike, dq: ArrayLike, theta: ArrayLike, dtheta: ArrayLike, tau: ArrayLike
    ) -> tuple[Array, Array]:
        """Accelerations of links and motors, q̈ and θ̈, under motor torques, two of (T, n) [rad/s²].

        Springs, damping, friction and coupling as in robot.yaml: De Luca, Schröder, Thümmel 2007, eq. (2);
        Ulrich, Sasiadek 2011, eqs. (10)–(16). Of a rigid joint `theta` and `dtheta` are not looked at; its motor
        accelerates as its link does.
        """
        self.require_masses("forward dynamics")
        stacked = self._rows(self.core.forward_dynamics, q=q, dq=dq, theta=theta, dtheta=dtheta, tau=tau)
        links, motors = stacked if stacked.ndim == 2 else np.moveaxis(stacked, 1, 0)
        return links, motors

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Inertia of the links M(q), (T, n, n) [kg m²]."""
        return self._rows(self.core.mass_matrix, q=q)

    def coriolis_matrix(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Coriolis matrix C(q, q̇) from Christoffel symbols, so that Ṁ − 2C is skew, (T, n, n)."""
        return self._rows(self.core.coriolis_matrix, q=q, dq=dq)

    def gravity_torque(self, q: ArrayLike) -> Array:
        """Torque that holds the links against gravity g(q), less what counterbalances carry, (T, n) [N m]."""
        return self._rows(self.core.gravity_torque, q=q)

    def link_friction(self, dq: ArrayLike, load: ArrayLike | None = None) -> Array:
        """Friction torque of the links (Ulrich and Sasiadek 2011, eq. (14)) and of their bearings, (T, n) [N m].

        `load`, (T, n): the torques that their motion takes beside it, none unless given, on which it may depend.
        """
        return self._rows(
            self.core.link_friction, dq=dq, load=np.zeros_like(numbers("dq", dq)) if load is None else load
        )

    def motor_friction(self, dtheta: ArrayLike, load: ArrayLike | None = None) -> Array:
        """Friction torque of the motors, viscous and dry with its Stribeck peak, and their gears', (T, n) [N m].

        `load`, (T, n): the torques that gears ask of motors, none unless given, a share of which is lost.
        """
        rest = np.zeros_like(numbers("dtheta", dtheta))
        return self._rows(self.core.motor_friction, dtheta=dtheta, load=rest if load is None else load)

    def specific_force(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Readings of the accelerometers, (T, acceleration channels) [m/s²]; +9.81 upward at rest."""
        return self._rows(self.core.specific_force, q=q, dq=dq, ddq=ddq)

    def acceleration_map(self, q: ArrayLike, dq: ArrayLike) -> tuple[Array, Array]:
        """T_A (T, channels, n) and W_A (T, channels): the accelerometers read T_A q̈ + W_A.

        De Luca, Schröder, Thümmel 2007, eq. (10).
        """
        rest = np.zeros_like(numbers("q", q))
        derivatives = self._rows(self.core.specific_force_derivatives, q=q, dq=dq, ddq=rest)
        return derivatives[..., 2, :, :], self.specific_force(q, dq, rest)

    def angular_rate(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Readings of the gyroscopes, (T, gyroscope channels) [rad/s]."""
        return self._rows(self.core.angular_rate, q=q, dq=dq)

    def tool_position(self, q: ArrayLike) -> Array:
        """Tool position in the base frame, (T, 3) [m]; raises EstimatorError if the robot has none."""
        if self.tool is None:
            raise EstimatorError("the robot has no tool: name one in robot.yaml, `tool: {link: …}`")
        return self._rows(self.core.tool_position, q=q)

    def _rows(self, kernel: Callable[..., Array], **arguments: ArrayLike) -> Array:
        """Call a kernel of (T, n) arrays on those, or on a single state (n,)."""
        try:
            return kernel(*arguments.values())  # arrays of float64 in C order go straight in
        except (TypeError, EstimatorError):
            return kernel(*self._converted(arguments))

    def _converted(self, arguments: dict[str, ArrayLike]) -> Iterator[Array]:
        """Give arrays that kernels take, of any numbers; refuse what is none."""
        arrays = {name: numbers(name, value) for name, value in arguments.items()}
        first, shape = next((name, array.shape) for name, array in arrays.items())
        if len(shape) not in (1, 2) or shape[-1] != self.n:
            raise EstimatorError(f"{first}: expected shape ({self.n},) or (T, {self.n}), got {shape}") from None
        for name, array in arrays.items():
            if array.shape != shape:
                raise EstimatorError(f"{name}: expected shape {shape}, that of {first}, got {array.shape}") from None
        return map(np.ascontiguousarray, arrays.values())
