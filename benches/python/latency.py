"""Compiles robots of 3, 6 and 7 joints into a folder, for `make latency`: the slowest steps of a controller's loop."""

import sys
from importlib.metadata import distribution
from pathlib import Path

import pinocchio

import linkside

EXAMPLES = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")))


def robots():
    """The demo's arm with three joints and with six, and a Panda."""
    demo = linkside.Robot.load(linkside.demo.ROBOT)
    settings = {"accelerometers": demo.accelerometers, "tool": demo.tool, "encoder": demo.config.encoder}
    urdf = Path(linkside.demo.ROBOT).parent / "robot.urdf"
    yield linkside.Robot.from_urdf(urdf, demo.drives[:3], accelerometers=[on_link(demo, "link3")])
    yield linkside.Robot.from_urdf(urdf, demo.drives, **settings)
    drive = {"stiffness": 1e4, "damping": 10.0, "motor_inertia": 0.5}
    panda = pinocchio.buildModelFromUrdf(str(EXAMPLES / "panda_description/urdf/panda.urdf"))
    names = [name for name in panda.names if name.startswith("panda_joint")][:7]
    sensors = [{"name": f"acc{link}", "link": f"panda_link{link}", "noise_std": 0.05} for link in (4, 6, 7)]
    yield linkside.Robot.from_pinocchio(panda, [{"name": name, **drive} for name in names], accelerometers=sensors)


def on_link(robot, link):
    """The robot's first accelerometer on another link."""
    return robot.accelerometers[0].model_copy(update={"link": link})


def main(folder):
    """Write a file for each robot and method, and print their paths."""
    for robot in robots():
        methods = {
            "observer": linkside.AccelerationObserver(robot, period=2.5e-4),
            "ekf": linkside.ExtendedKalmanFilter(robot, start="rest"),
            "elastic-ekf": linkside.ElasticJointFilter(robot, start="rest"),
            "velocity": linkside.ReducedOrderObserver(robot, period=2.5e-4),
        }
        for name, method in methods.items():
            path = Path(folder) / f"{name}-{robot.n}.lsr"
            method.compile(path, period=2.5e-4)
            print(path)


if __name__ == "__main__":
    main(sys.argv[1])
