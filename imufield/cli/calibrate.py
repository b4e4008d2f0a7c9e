"""Arguments of the commands that turn samples into numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imufield.cli.options import LARGEST_SEED, AsJson, GravityValue, Height, Latitude, Scheduler, Workers, site, within


def solve(
    *,
    context: typer.Context,
    sessions: Annotated[
        list[Path] | None, typer.Argument(metavar="[SESSION]...", help="Session folders (default: the newest).", readable=False)
    ] = None,
    observations: Annotated[
        Path | None, typer.Option(help="CSV of position means instead of a session.", readable=False)
    ] = None,
    gravity: GravityValue = None,
    latitude: Latitude = None,
    height: Height = None,
    model: Annotated[str, typer.Option(help="auto, linear or quadratic.")] = "auto",
    gauge: Annotated[str | None, typer.Option(help="preset, lower, upper or symmetric.")] = None,
    preset: Annotated[Path | None, typer.Option(help="Parameter file in force before.", readable=False)] = None,
    zero: Annotated[str | None, typer.Option(help="Raw output at zero input, one or three numbers.")] = None,
    method: Annotated[str, typer.Option(help="least-squares, bsas, ide and others, see docs/study.md.")] = "least-squares",
    polish: Annotated[bool, typer.Option(help="Finish another method by least squares.")] = True,
    cross_check: Annotated[bool, typer.Option("--cross-check", help="Solve by bsas, ide and least squares, compare.")] = False,
    gyro_model: Annotated[str, typer.Option(help="auto, basic or g-sensitive.")] = "auto",
    seed: Annotated[int, typer.Option(help="Seed of everything random.", callback=within(0, LARGEST_SEED))] = 0,
    workers: Workers = None,
    scheduler: Scheduler = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Where to write the parameter file.", readable=False)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Solve a session: parameters with uncertainty, and a verdict in words. Several: on all cores, with a table of verdicts.

    Example: imufield solve --latitude 48.1 --height 520
    """
    from imufield.commands.solve import SolveOptions, run_solve

    options = SolveOptions(
        session=sessions[0] if sessions and len(sessions) == 1 else None,
        observations=observations,
        site=site(context, gravity, latitude, height),
        model=model,
        gauge=gauge,
        preset=preset,
        zero=zero,
        method=method,
        polish=polish,
        cross_check=cross_check,
        gyroscope_model=gyro_model,
        seed=seed,
        output=output,
        as_json=as_json,
    )
    if scheduler is not None or len(sessions or ()) > 1:
        from imufield.commands.solve_many import run_solve_many

        raise typer.Exit(run_solve_many(sessions or (), options, workers=workers, scheduler=scheduler))
    run_solve(options)


def noise(
    *,
    session: Annotated[Path | None, typer.Argument(help="Session folder (default: the newest).", readable=False)] = None,
    to: Annotated[str, typer.Option(help="Form of --output: kalibr, openvins, vins or ros2.")] = "kalibr",
    output: Annotated[Path | None, typer.Option("-o", "--output", help="YAML for a navigation filter.", readable=False)] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Draw the Allan deviation into this file (needs matplotlib).", readable=False)
    ] = None,
    parameters: Annotated[
        Path | None, typer.Option(help="Parameter file to write the table `noise` into.", readable=False)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure the noise of hours of standstill by Allan deviation.

    Example: imufield noise my-standstill --plot allan.png
    """
    from imufield.commands.noise import NoiseOptions, run_noise

    options = NoiseOptions(session=session, to=to, output=output, plot=plot, parameters=parameters, as_json=as_json)
    run_noise(options)


def study(
    *,
    name: Annotated[str, typer.Argument(help="One of the studies below, a paper (bsas, ide), or all.")],
    quick: Annotated[bool, typer.Option("--quick", help="Few runs, to see that it works.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of all runs.", callback=within(0, LARGEST_SEED))] = 0,
    workers: Workers = None,
    scheduler: Scheduler = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for CSV files and plots.", readable=False)
    ] = None,
    document: Annotated[Path | None, typer.Option(help="Write all as one Markdown document.", readable=False)] = None,
) -> None:
    """Reproduce a table or figure of the papers, paper's and our figures side by side.

    BAS is beetle antennae search, BSAS the swarm of it (with m beetles); IDE is improved differential evolution.

    Studies: bsas-table1, bsas-table2, bsas-fig3, bsas-fig4, bsas-fig5, bsas-fig6, bsas-fig7, bsas-table3,
    bsas-staged, bsas-whitened, bsas-bound, bsas-table4, bsas-table5, bsas-fig9, bsas-table6, bsas-fig10,
    bsas-fig11, ide-table1, ide-fig2, ide-fig3, ide-fig4, ide-fig5, ide-table2, ide-table3, ide-fig6, ide-fig8,
    ide-table4, ide-table5, ide-fig10.

    Example: imufield study bsas-table3 --quick
    """
    from imufield.commands.study import run_study_command

    run_study_command(name, quick=quick, seed=seed, workers=workers, scheduler=scheduler, output=output, document=document)
