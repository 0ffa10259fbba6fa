"""Who estimates link velocities best: observers with a model, or filters without one, behind encoders of 16 bits.

True link positions of recordings are rounded as an encoder does, torques are those of the links' dynamics, exact or 5 %
too large. Each method runs at its best setting for the recording, found by search. All are causal.
"""

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_discrete_are
from scipy.signal import butter, lfilter, ss2tf

from linkside import Estimate, Log, NicosiaTomeiObserver, ReducedOrderObserver, Robot

Array = npt.NDArray[np.float64]

DATA = Path(__file__).parents[1] / "tests/data"
RECORDINGS = ("arm2_square", "kr15_six_axes")
STEP = 2 * np.pi / 2**16
SETTLED = 200  # samples
GAINS = np.geomspace(5, 640, 15)
CUTOFFS = np.geomspace(5, 320, 25)
JERKS = np.geomspace(1e-1, 1e7, 33)


class Motion:
    """Link motion of a recording, and what encoders make of it."""

    def __init__(self, name: str) -> None:
        self.robot = Robot.load(DATA / name / "robot.yaml")
        truth = Estimate.read(DATA / name / "truth.parquet")
        self.t, self.dq = truth.t, truth.dq
        self.period = float(self.t[1] - self.t[0])
        self.q = STEP * np.round(truth.q / STEP)
        friction = self.robot.link_friction(truth.dq)
        self.torque = self.robot.inverse_dynamics(truth.q, truth.dq, truth.ddq) + friction

    def log(self, error: float) -> Log:
        """What observers are given, torques too large by a fraction."""
        signals = {"theta": self.q, "q": self.q, "torque": (1 + error) * self.torque}
        columns = {f"{s}_{n}": x[:, j] for s, x in signals.items() for j, n in enumerate(self.robot.names)}
        return Log.from_table({"t": self.t, **columns}, self.robot)

    def rms(self, dq: Array) -> float:
        """Of the error of all joints' velocities [rad/s]."""
        return float(np.sqrt(((dq - self.dq)[SETTLED:] ** 2).mean()))


def observer(kind: type[ReducedOrderObserver], motion: Motion, error: float) -> Callable[[float], Array]:
    """An observer's velocities by its gain [1/s]."""
    log = motion.log(error)
    return lambda gain: kind(motion.robot, gain, side="links").run(log).dq


def butterworth(motion: Motion, order: int) -> Callable[[float], Array]:
    """The filtered difference of two positions by its cutoff frequency [Hz]."""
    difference = np.diff(motion.q, axis=0, prepend=motion.q[:1]) / motion.period
    return lambda cutoff: np.asarray(lfilter(*butter(order, cutoff, fs=1 / motion.period), difference, axis=0))


def kalman(motion: Motion) -> Callable[[float], Array]:
    """The settled Kalman filter of a constant acceleration by its white jerk [rad/s³/√Hz]."""
    t, read = motion.period, np.array([[1.0, 0.0, 0.0]])
    ahead = np.array([[1, t, t**2 / 2], [0, 1, t], [0, 0, 1]])
    spread = np.array([[t**5 / 20, t**4 / 8, t**3 / 6], [t**4 / 8, t**3 / 3, t**2 / 2], [t**3 / 6, t**2 / 2, t]])

    def run(jerk: float) -> Array:
        noise = np.array([[STEP**2 / 12]])
        variance = solve_discrete_are(ahead.T, read.T, jerk**2 * spread, noise)
        gain = variance @ read.T / (read @ variance @ read.T + noise)
        kept = (np.eye(3) - gain @ read) @ ahead
        above, below = ss2tf(kept, kept @ gain, np.eye(3)[1:2], gain[1:2])
        return np.asarray(lfilter(above[0], below, motion.q - motion.q[0], axis=0))

    return run


def best(motion: Motion, run: Callable[[float], Array], settings: Iterable[float]) -> tuple[float, float]:
    """Least error, and the setting that has it."""
    return min((motion.rms(run(float(setting))), float(setting)) for setting in settings)


def compare(name: str) -> None:
    """Print the errors of all methods on one recording."""
    motion = Motion(name)
    print(f"{name}: {len(motion.t)} samples, {1 / motion.period:.0f} Hz")
    rows = []
    for error in (0.0, 0.05):
        for kind in (ReducedOrderObserver, NicosiaTomeiObserver):
            what = f"{kind.__name__}, torques {100 * error:.0f} % off"
            rows.append((what, best(motion, observer(kind, motion, error), GAINS), "1/s"))
    rows.append(("Kalman filter, constant acceleration", best(motion, kalman(motion), JERKS), "rad/s³/√Hz"))
    for order in (1, 2, 3, 4):
        rows.append(
            (f"difference, Butterworth, order {order}", best(motion, butterworth(motion, order), CUTOFFS), "Hz")
        )
    for what, (error, setting), unit in rows:
        print(f"  {what:42} {1e3 * error:7.2f} mrad/s at {setting:.3g} {unit}")


def main() -> None:
    """Compare on the recordings named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("recordings", nargs="*", default=RECORDINGS, help="folders of tests/data")
    for name in parser.parse_args().recordings:
        compare(name)


if __name__ == "__main__":
    main()
