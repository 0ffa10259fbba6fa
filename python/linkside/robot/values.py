"""Values that sections of robot.yaml hold: numbers, vectors, and what is refused of them."""

from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field

from linkside.files.yaml_source import refusal

T = TypeVar("T")


def _listed(value: Any) -> Any:
    """Take a NumPy array for the list it stands for."""
    return value.tolist() if hasattr(value, "tolist") else value


def _exactly(count: int) -> AfterValidator:
    """Require this many numbers; pydantic's own check of the length would not count invalid ones."""

    def check(value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) != count:
            raise refusal(f"expected {count} numbers, got {len(value)}")
        return value

    return AfterValidator(check)


def some(value: tuple[T, ...]) -> tuple[T, ...]:
    """Refuse an empty list."""
    if not value:
        raise refusal("expected a list of one joint or more, got an empty one")
    return value


def nonzero(value: float) -> float:
    """Refuse zero."""
    if value == 0:
        raise refusal("expected a number other than 0, got 0")
    return value


Listed = BeforeValidator(_listed)

# Strict: neither true nor "3" is a number. `float` sheds the subclasses of ruamel.yaml and NumPy.
Number = Annotated[float, Listed, Field(strict=True, allow_inf_nan=False), AfterValidator(float)]
Positive = Annotated[Number, Field(gt=0)]
NonNegative = Annotated[Number, Field(ge=0)]
Vector3 = Annotated[tuple[Number, ...], Listed, _exactly(3)]
PositiveVector3 = Annotated[tuple[Positive, ...], Listed, _exactly(3)]
Vector6 = Annotated[tuple[Number, ...], Listed, _exactly(6)]
