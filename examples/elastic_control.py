"""Estimation and control of the KR15-like robot's first joint, after De Luca, Schröder and Thümmel (ICRA 2007).

Joint 1 moves by 5° and by 30°. Figures 3 and 4 of the paper: observed against true states. Figures 5 and 6: full-state
feedback on the estimate against feedback of the motors alone. The robot is another than the one that the controller
knows: springs 5 % softer; motors, links and damping 5 % up; encoders quantised, accelerometers noisy.

    python examples/elastic_control.py --out figures
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import linkside
from linkside import AccelerationObserver, Log, Robot, simulate
from linkside.control import inverse_dynamics
from linkside.control.feedback import StateFeedback, motor_only, pole_placement
from linkside.control.trajectories import rest_to_rest

PERIOD = 5e-4
MOTIONS = {"short": (5.0, 0.2), "long": (30.0, 0.4)}  # [°], [s]
BEFORE = 0.05  # at rest [s]
AFTER = 1.0  # looked at after the motion [s]


def experiment(robot, start, angle, duration, gains, poles=250.0, period=PERIOD):
    """Run one motion; give time, desired, true (θ, q, θ̇, q̇) and observed states of joint 1."""
    goal = start + np.radians(angle) * np.eye(robot.n)[0]
    motion = rest_to_rest([start, goal], duration, period).held(BEFORE, AFTER)
    desired = inverse_dynamics(robot, motion)
    controller = StateFeedback(robot, desired, gains, AccelerationObserver(robot, poles, period=period))
    specimen = robot.scaled(stiffness=0.95, damping=1.05, motor_inertia=1.05, mass=1.05)
    steps = int(np.ceil(period / 2.5e-4))
    run = simulate(
        specimen, controller, motion.t[-1], 1 / period, q=start, feedback=controller.observer, substeps=steps
    )
    names = ("theta", "q", "dtheta", "dq")
    true, observed = (np.stack([of[name][:, 0] for name in names], axis=1) for of in (run.truth, run.known._asdict()))
    return motion.t, desired.q[:, 0], true, observed


def vibration(t, q, true, duration):
    """Overshoot beyond the goal, and residual vibration peak to peak, after the motion's end [mrad]."""
    after = 1e3 * (true[t >= BEFORE + duration, 1] - q[-1])
    return max(after.max(), 0.0), np.ptp(after[len(after) // 10 :])


def observed_figure(t, true, observed, title):
    """Draw motor position and velocity, torsion and link velocity."""
    figure = Figure(figsize=(10, 6), layout="constrained")
    figure.suptitle(title)
    degrees = np.degrees(1.0)
    rows = [
        ("motor position [°]", true[:, 0] * degrees, observed[:, 0] * degrees),
        ("motor velocity [°/s]", true[:, 2] * degrees, observed[:, 2] * degrees),
        ("torsion [mrad]", 1e3 * (true[:, 0] - true[:, 1]), 1e3 * (observed[:, 0] - observed[:, 1])),
        ("link velocity [°/s]", true[:, 3] * degrees, observed[:, 3] * degrees),
    ]
    for axes, (label, one, other) in zip(figure.subplots(2, 2, sharex=True).flat, rows, strict=True):
        axes.plot(t, one, color="0.6", linewidth=3, label="true")
        axes.plot(t, other, color="#0072B2", linewidth=1, label="observed")
        axes.set(ylabel=label, xlabel="time [s]")
        axes.grid(True, color="0.9")
    axes.legend(frameon=False)
    return figure


def control_figure(results, title):
    """Draw the link's position, and its deviation from the goal after the motion."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    figure.suptitle(title)
    left, right = figure.subplots(1, 2)
    t, q = results["full state"][:2]
    left.plot(t, np.degrees(q), color="0.6", linewidth=3, label="desired")
    for (name, (_, _, true, _)), colour in zip(results.items(), ("#0072B2", "#D55E00"), strict=True):
        left.plot(t, np.degrees(true[:, 1]), color=colour, label=name)
        right.plot(t, 1e3 * (true[:, 1] - q), color=colour, label=name)
    left.set(xlabel="time [s]", ylabel="link position [°]")
    right.set(xlabel="time [s]", ylabel="link less desired [mrad]")
    for axes in (left, right):
        axes.grid(True, color="0.9")
        axes.legend(frameon=False)
    return figure


def main():
    """Run all experiments, print the figures of merit, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("figures"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    robot = Robot.load(linkside.demo.ROBOT)
    start = Log.read(linkside.demo.LOG, robot).theta[0]
    controls = {"full state": pole_placement(robot, start), "motors only": motor_only(robot, start)}
    print(f"{'':20}{'overshoot [mrad]':>18}{'vibration [mrad]':>18}{'torsion error [mrad]':>22}")
    for motion, (angle, duration) in MOTIONS.items():
        results = {name: experiment(robot, start, angle, duration, gains) for name, gains in controls.items()}
        merits = []
        for name, (t, q, true, observed) in results.items():
            merits.append(vibration(t, q, true, duration))
            overshoot, residual = merits[-1]
            error = 1e3 * np.sqrt(np.mean(((true - observed) @ [1, -1, 0, 0]) ** 2))
            print(f"{motion + ', ' + name:20}{overshoot:18.4f}{residual:18.4f}{error:22.4f}")
        overshoot, residual = np.divide(*merits)
        print(f"{motion + ', full state to motors only':30}{overshoot:8.2f}{residual:18.2f}")
        title = f"Joint 1 by {angle:g}°"
        t, _, true, observed = results["full state"]
        observed_figure(t, true, observed, f"{title}: observed and true states").savefig(out / f"observed_{motion}.png")
        control_figure(results, f"{title}: what is fed back").savefig(out / f"control_{motion}.png")


if __name__ == "__main__":
    main()
