"""The commands of `imufield`, in the order and under the headings of the help; what each does is a sentence of the room."""

from __future__ import annotations

COMMANDS: dict[str, dict[str, tuple[str, str, str]]] = {
    "Calibrate": {
        "web": ("samples.WebOptions", "web.run_web", "commands.web"),
        "init": ("samples.InitOptions", "init.run_init", "commands.init"),
        "devices": ("samples.DevicesOptions", "devices.list_devices", "commands.devices"),
        "probe": ("samples.ProbeOptions", "probe.run_probe", "commands.probe"),
        "plan": ("samples.PlanOptions", "plan.run_plan", "commands.plan"),
        "capture": ("samples.CaptureOptions", "capture.run_capture", "commands.capture"),
        "solve": ("results.SolveOptions", "solve.run_solve", "commands.solve"),
        "report": ("results.ReportOptions", "report.run_report", "commands.report"),
        "export": ("results.ExportOptions", "export.run_export", "commands.export"),
    },
    "Prove and compare": {
        "verify": ("results.VerifyOptions", "verify.run_verify", "commands.verify"),
        "certificate": ("results.CertificateOptions", "certificate.run_certificate", "commands.certificate"),
        "history": ("results.HistoryOptions", "history.run_history", "commands.history"),
        "noise": ("results.NoiseOptions", "noise.run_noise", "commands.noise"),
    },
    "Recordings": {
        "sessions": ("samples.SessionsOptions", "sessions.list_sessions", "commands.sessions"),
        "record": ("samples.RecordOptions", "record.run_record", "commands.record"),
        "import": ("samples.ImportOptions", "import_files.run_import", "commands.import"),
        "replay": ("samples.ReplayOptions", "replay.run_replay", "commands.replay"),
        "apply": ("results.ApplyOptions", "apply.run_apply", "commands.apply"),
        "export-data": ("results.ExportDataOptions", "export_data.run_export_data", "commands.export-data"),
    },
    "Without hardware": {
        "demo": ("samples.DemoOptions", "demo.run_demo", "commands.demo"),
        "emulate": ("samples.EmulateOptions", "emulate.run_emulate", "commands.emulate"),
        "study": ("results.StudyOptions", "study.run_study_command", "commands.study"),
    },
}
"""Under each heading, by name: options below ``imufield.commands.options``, function below ``imufield.commands``, sentence."""
NAMES = frozenset(name for commands in COMMANDS.values() for name in commands)
