"""The group of commands."""

from __future__ import annotations

import click

from .failures import Commands


@click.group(cls=Commands, invoke_without_command=True, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="linkside")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
@click.pass_context
def main(ctx: click.Context, debug: bool) -> None:
    """Estimate where the links of a robot with elastic joints really are."""
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())
