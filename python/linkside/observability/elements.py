"""What each element of a transmission does to how well links are seen, in words."""

from __future__ import annotations

from collections.abc import Iterator

from linkside.robot import Robot
from linkside.robot.joints import JointConfig


def element_words(robot: Robot) -> Iterator[str]:
    """Say it of each joint that has one, and of what joints share."""
    for drive in robot.drives:
        yield from _of_spring(drive)
        yield from _of_readings(drive)
    for joint, shares in robot.config.gearing.items():
        motors = ", ".join(dict.fromkeys((joint, *shares)))
        yield f"{joint} is turned by the motors of {motors}: a reading that one of them lacks is missing for {joint}."
    for joint, linkage in robot.config.linkages.items():
        yield f"{joint} moves with {linkage.follows}: accelerometers behind it see {linkage.follows} through both."
    yield from _of_wrenches(robot)
    if robot.config.counterbalances:
        yield (
            "Counterbalances carry weight: nothing is lost by them, and an error of their torque is a wrong torsion, "
            "as one of a mass is."
        )


def _of_wrenches(robot: Robot) -> Iterator[str]:
    for wrench in robot.config.wrenches:
        if wrench.kind == "constant":
            yield f"{wrench.name} is known: nothing is lost by it, and an error of it is a wrong torsion."
        elif wrench.kind == "measured":
            yield f"{wrench.name} is measured: torsions by it are known as well as its force sensor reads."
        else:
            yield (
                f"{wrench.name} twists springs by what nothing measures: link encoders and joint torque sensors tell "
                "it, accelerometers only as it changes, motor torques as well as friction is known."
            )


def _of_spring(drive: JointConfig) -> Iterator[str]:
    if drive.elastic and drive.backlash.half_gap:
        gap = f"within {1e3 * drive.backlash.half_gap:.3g} mrad to either side"
        yield f"{drive.name} has play: {gap} accelerometers tell where its link is, its motor hardly does."
    if drive.hysteresis:
        way = 1e3 * max(2 * element.reach for element in drive.hysteresis)
        offset = 1e6 * sum(element.limit for element in drive.hysteresis) / (drive.stiffness or 1.0)
        yield (
            f"{drive.name} has friction beside its spring: until its torsion has changed by some {way:.3g} mrad, no "
            f"sensor but a link's encoder tells where it was at the start, up to {offset:.3g} µrad of the link."
        )
    if drive.ripple:
        yield f"{drive.name} has ripple: nothing is lost by it; link encoders or accelerometers show whether it fits."
    if drive.passive:
        yield (
            f"{drive.name} has no motor whose encoder tells where it is: its spring's torque and accelerometers behind "
            "it do."
        )


def _of_readings(drive: JointConfig) -> Iterator[str]:
    for error, encoder, turns in (
        (drive.encoder_error, "motor's", drive.gear_ratio),
        (drive.link_encoder_error, "link's", 1.0),
    ):
        if lines := error.unknown(turns):
            size = 1e6 * sum(0.5 * amplitude**2 for amplitude, _ in lines) ** 0.5
            yield (
                f"{drive.name}: its {encoder} encoder has lines of {size:.3g} µrad RMS whose phase no recording tells; "
                "they count in standard deviations."
            )
    bearing = drive.bearing_friction
    if bearing.coulomb or bearing.stribeck or bearing.load:
        yield f"{drive.name} has dry friction in its bearing: where its link sticks and breaks away, rows are flagged."
