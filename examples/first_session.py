"""The first session of README.md and of docs/kalman.md, as type checkers see it."""

# ruff: noqa: B905, E402
# pyright: reportDuplicateImport=false

import linkside
from linkside import AccelerationObserver, Log, Robot

robot = Robot.load(linkside.demo.ROBOT)  # your robot.yaml, beside its URDF
log = Log.read(linkside.demo.LOG, robot)  # your recording: Parquet or CSV; tables by Log.from_table
observer = AccelerationObserver(robot, poles=250)
estimate = observer.run(log)  # or a list of logs, on all cores

print(estimate.q.shape, estimate.names)  # (2000, 6) ('a1', 'a2', 'a3', 'a4', 'a5', 'a6')
print(estimate.status_summary())  # {'good': 2000, 'damped': 0, 'bridged': 0, 'unseen': 0, …}
print(estimate.error_against(linkside.demo.TRUTH).tool_rms_centred_mm)  # 0.059
estimate.write("estimate.parquet")

for theta, tau, acceleration in zip(*log.require("theta", "tau", "acceleration")):
    state = observer.step(theta=theta, tau=tau, acceleration=acceleration)
    link, velocity, tool = state.q, state.dq, state.tool_position

import linkside
from linkside import Estimate, ExtendedKalmanFilter, Log, RauchTungStriebelSmoother, Robot
from linkside.consistency import consistency

robot = Robot.load(linkside.demo.ROBOT)
log = Log.read(linkside.demo.LOG, robot)
smoothed = RauchTungStriebelSmoother(robot).run(log)  # each row from all samples
tool, tool_std = smoothed.require("tool_position", "tool_std")
print(tool[1000], tool_std[1000])  # [m]
print(smoothed.error_against(linkside.demo.TRUTH).tool_rms_centred_mm)  # 0.042

filtered = ExtendedKalmanFilter(robot).run(log, innovations=True)  # each row from the samples up to it
print(consistency(filtered, Estimate.read(linkside.demo.TRUTH)).to_text())  # can it be trusted?
