"""The commands of `imufield`, in the order and under the headings in which the help lists them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, cast

import typer
from typer.core import TyperCommand, TyperGroup

from imufield.cli.command import make_command
from imufield.commands.options import results, samples
from imufield.sentences import printable_lines
from imufield.version import __version__

# What typer raises for a wrong command line. The class has a public name in some versions only; this one has it in all.
_UsageError = cast("type[Exception]", typer.BadParameter.__bases__[0])


def _without_type(parameters: Iterable[object]) -> list[object]:
    """Return the parameters, and let help show no type beside those that have no value."""
    for parameter in (parameters := [*parameters]):
        if getattr(parameter, "is_flag", False):
            vars(parameter)["metavar"] = ""
    return parameters


class _Command(TyperCommand):
    def get_params(self, ctx: typer.Context) -> list[object]:  # type: ignore[override]  # typer names the base of it
        return _without_type(super().get_params(ctx))


class _Commands(TyperGroup):
    def get_params(self, ctx: typer.Context) -> list[object]:  # type: ignore[override]  # the same
        return _without_type(super().get_params(ctx))

    def invoke(self, ctx: typer.Context) -> object:  # type: ignore[override]  # typer names the base of it
        try:
            return super().invoke(ctx)
        except _UsageError as error:
            # What it quotes may be a name that a shell filled in, and typer prints it itself.
            vars(error)["message"] = printable_lines(str(vars(error)["message"]))
            raise


app = typer.Typer(
    name="imufield",
    cls=_Commands,
    help="Calibrate an IMU in the field: no turntable, 24 positions by hand, a parameter file for your INS.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["--help", "-h"]},
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"imufield {__version__}")
        raise typer.Exit


@app.callback()
def root(
    context: typer.Context,
    version: Annotated[  # noqa: ARG001  (answered by its callback, before a command is asked for)
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Calibrate an IMU in the field: no turntable, 24 positions by hand, a parameter file for your INS."""
    from imufield.commands.configuration import default_map

    context.default_map = default_map()


# Under each heading: name, options, and the function below imufield.commands that does the work.
_COMMANDS: dict[str, tuple[tuple[str, type, str], ...]] = {
    "Calibrate": (
        ("web", samples.WebOptions, "web.run_web"),
        ("init", samples.InitOptions, "init.run_init"),
        ("devices", samples.DevicesOptions, "devices.list_devices"),
        ("probe", samples.ProbeOptions, "probe.run_probe"),
        ("plan", samples.PlanOptions, "plan.run_plan"),
        ("capture", samples.CaptureOptions, "capture.run_capture"),
        ("solve", results.SolveOptions, "solve.run_solve"),
        ("report", results.ReportOptions, "report.run_report"),
        ("export", results.ExportOptions, "export.run_export"),
    ),
    "Prove and compare": (
        ("verify", results.VerifyOptions, "verify.run_verify"),
        ("certificate", results.CertificateOptions, "certificate.run_certificate"),
        ("history", results.HistoryOptions, "history.run_history"),
        ("noise", results.NoiseOptions, "noise.run_noise"),
    ),
    "Recordings": (
        ("sessions", samples.SessionsOptions, "sessions.list_sessions"),
        ("record", samples.RecordOptions, "record.run_record"),
        ("import", samples.ImportOptions, "import_files.run_import"),
        ("replay", samples.ReplayOptions, "replay.run_replay"),
        ("apply", results.ApplyOptions, "apply.run_apply"),
        ("export-data", results.ExportDataOptions, "export_data.run_export_data"),
    ),
    "Without hardware": (
        ("demo", samples.DemoOptions, "demo.run_demo"),
        ("emulate", samples.EmulateOptions, "emulate.run_emulate"),
        ("study", results.StudyOptions, "study.run_study_command"),
    ),
}

for _panel, _row in _COMMANDS.items():
    for _name, _options, _work in _row:
        app.command(_name, cls=_Command, rich_help_panel=_panel)(make_command(_options, _work))
