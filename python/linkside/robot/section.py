"""What the sections of robot.yaml have in common."""

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from linkside.files.yaml_source import refusal, suggest


def _printable(value: str) -> str:
    if not value or not value.isprintable():
        raise refusal(f"expected printable text, got {value!r}")
    return value


Name = Annotated[str, AfterValidator(_printable)]


def _listed(value: Any) -> Any:
    """Take a NumPy array for the list it stands for."""
    return value.tolist() if hasattr(value, "tolist") else value


def _exactly(count: int) -> AfterValidator:
    """Ask for so many numbers; pydantic's own check of length would not count those it finds fault with."""

    def check(value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) != count:
            raise refusal(f"expected {count} numbers, got {len(value)}")
        return value

    return AfterValidator(check)


Listed = BeforeValidator(_listed)

# Strict: neither true nor "3" is a number. `float` sheds the subclasses of ruamel.yaml and NumPy.
Number = Annotated[float, Listed, Field(strict=True, allow_inf_nan=False), AfterValidator(float)]
Positive = Annotated[Number, Field(gt=0)]
NonNegative = Annotated[Number, Field(ge=0)]
Vector3 = Annotated[tuple[Number, ...], Listed, _exactly(3)]
PositiveVector3 = Annotated[tuple[Positive, ...], Listed, _exactly(3)]
Vector6 = Annotated[tuple[Number, ...], Listed, _exactly(6)]


class Section(BaseModel):
    """A mapping with a fixed set of keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _keys_known(cls, data: Any) -> Any:
        """Ahead of all other checks: a misspelt key must not be reported as a missing one."""
        if isinstance(data, dict) and cls.model_config.get("extra") == "forbid":
            for key in data:
                if isinstance(key, str) and key not in cls.model_fields:
                    raise refusal(f"unknown key; {suggest(key, cls.model_fields)}", key)
        return data
