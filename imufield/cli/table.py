"""The commands of `imufield`, in the order and under the headings of the help; what each does is a sentence of the room."""

from __future__ import annotations

COMMANDS: dict[str, dict[str, tuple[str, str, str]]] = {
    "Calibrate": {
        "web": ("acquire_commands.WebOptions", "web.run_web", "commands.web"),
        "init": ("acquire_commands.InitOptions", "init.run_init", "commands.init"),
        "devices": ("acquire_commands.DevicesOptions", "devices.list_devices", "commands.devices"),
        "probe": ("acquire_commands.ProbeOptions", "probe.run_probe", "commands.probe"),
        "plan": ("acquire_commands.PlanOptions", "plan.run_plan", "commands.plan"),
        "capture": ("acquire_commands.CaptureOptions", "capture.run_capture", "commands.capture"),
        "solve": ("result_commands.SolveOptions", "solve.run_solve", "commands.solve"),
        "report": ("result_commands.ReportOptions", "report.run_report", "commands.report"),
        "export": ("result_commands.ExportOptions", "export.run_export", "commands.export"),
    },
    "Prove and compare": {
        "verify": ("result_commands.VerifyOptions", "verify.run_verify", "commands.verify"),
        "certificate": ("result_commands.CertificateOptions", "certificate.run_certificate", "commands.certificate"),
        "history": ("result_commands.HistoryOptions", "history.run_history", "commands.history"),
        "noise": ("result_commands.NoiseOptions", "noise.run_noise", "commands.noise"),
    },
    "Recordings": {
        "sessions": ("acquire_commands.SessionsOptions", "sessions.list_sessions", "commands.sessions"),
        "record": ("acquire_commands.RecordOptions", "record.run_record", "commands.record"),
        "import": ("acquire_commands.ImportOptions", "import_files.run_import", "commands.import"),
        "replay": ("acquire_commands.ReplayOptions", "replay.run_replay", "commands.replay"),
        "apply": ("result_commands.ApplyOptions", "apply.run_apply", "commands.apply"),
        "export-data": ("result_commands.ExportDataOptions", "export_data.run_export_data", "commands.export-data"),
    },
    "Without hardware": {
        "demo": ("acquire_commands.DemoOptions", "demo.run_demo", "commands.demo"),
        "emulate": ("acquire_commands.EmulateOptions", "emulate.run_emulate", "commands.emulate"),
        "study": ("result_commands.StudyOptions", "study.run_study_command", "commands.study"),
    },
}
"""Under each heading, by name: options below ``imufield.commands.options``, function below ``imufield.commands``, sentence."""
NAMES = frozenset(name for commands in COMMANDS.values() for name in commands)
COMPLETION = "_IMUFIELD_COMPLETE"
"""Variable by which a shell asks typer for words to complete."""
