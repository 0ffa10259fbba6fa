"""The common part of the sections of robot.yaml."""

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, model_validator

from linkside.files.yaml_source import refusal, suggest


def _printable(value: str) -> str:
    if not value or not value.isprintable():
        raise refusal(f"expected printable text, got {value!r}")
    return value


Name = Annotated[str, AfterValidator(_printable)]


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
