"""The section `sources` of robot.yaml: which fields of a bag's messages are which columns of a log."""

from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, model_validator

from linkside.files.yaml_source import refusal

from .section import Name, Section

JOINT_STATE = {"theta": "position", "dtheta": "velocity", "tau": "effort"}
"""Where a JointState has them, unless it is said otherwise."""


class JointsSource(Section):
    """Messages with an array of joint names, and an array for each signal: a JointState, unless it says otherwise.

    Each signal names the path of its array; where none does, motors are meant: `JOINT_STATE`.
    """

    topic: Name
    names: Name = "name"
    theta: Name | None = None
    dtheta: Name | None = None
    tau: Name | None = None
    current: Name | None = None
    q: Name | None = None
    dq: Name | None = None
    ddq: Name | None = None
    torque: Name | None = None
    qref: Name | None = None
    dqref: Name | None = None
    ddqref: Name | None = None

    @property
    def paths(self) -> dict[str, str]:
        """The path of each signal that is there."""
        return self.model_dump(exclude={"topic", "names"}, exclude_none=True) or JOINT_STATE


def _several(value: Any) -> Any:
    """Accept a topic in place of a source, and one source in place of a list."""
    sources = value if isinstance(value, list | tuple) else [value]
    return [{"topic": source} if isinstance(source, str) else source for source in sources]


def _field(value: str) -> str:
    topic, _, path = value.rpartition(":")
    if not topic or not path:
        raise refusal(f"expected TOPIC:PATH, as in /state:reference.positions[0], got {value!r}")
    return value


class SourcesConfig(Section):
    """What a bag is a log by. Topics of the same kind may be given as a list, or by the names of sensors or columns."""

    joints: Annotated[tuple[JointsSource, ...], BeforeValidator(_several)] = ()
    imu: dict[Name, Name] = {}  # accelerometer or gyroscope: topic of Imu; columns <name>_x|y|z and _wx|wy|wz
    wrench: dict[Name, Name] = {}  # name: topic of WrenchStamped; columns <name>_fx|fy|fz and _tx|ty|tz
    fields: dict[Name, Annotated[Name, AfterValidator(_field)]] = {}  # column: TOPIC:PATH, a number of any message

    @property
    def some(self) -> bool:
        """Whether there are any."""
        return bool(self.joints or self.imu or self.wrench or self.fields)

    @model_validator(mode="after")
    def _time_not_taken(self) -> "SourcesConfig":
        if "t" in self.fields:
            raise refusal("expected another column: time is that of the messages' stamps", "fields", "t")
        return self
