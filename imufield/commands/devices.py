"""``imufield devices``: ports of this machine, and the instruments that have a driver."""

from __future__ import annotations

import inspect
import json
from typing import Any

from imufield.acquire.link.ports import can_channels, serial_ports
from imufield.acquire.registry import driver_names, load_driver
from imufield.commands.options.acquire_commands import DevicesOptions
from imufield.commands.terminal.output import echo
from imufield.dataclass import asdict
from imufield.deliver.parameters.printed_numbers import hanging
from imufield.errors import ProtocolError
from imufield.sentences import Sentences, printable

sentence = Sentences(__package__)

_TRIED = "verified on real bytes"


def list_devices(options: DevicesOptions) -> None:
    """Print ports, CAN channels and drivers, or one of them; a driver that cannot be loaded is listed with its error.

    Raises
    ------
    ProtocolError
        If the instrument that was named has no driver, or it cannot be loaded.
    """
    if options.name is not None:
        load_driver(options.name)
        facts = _describe(options.name, whole=True)
        if options.as_json:
            echo(json.dumps(facts))
        else:
            _show(facts)
        return
    ports = [asdict(port) for port in serial_ports()]
    buses = can_channels()
    drivers = [_describe(name) for name in driver_names()]
    if options.as_json:
        echo(json.dumps({"ports": ports, "buses": [asdict(bus) for bus in buses], "drivers": drivers}))
        return
    if not ports:
        echo("no serial ports found: plug the instrument in, or give --port socket://host:port")
    else:
        width = max(len("port"), *(len(port["device"]) for port in ports)) + 2
        echo(f"serial ports\n{'port':<{width}}description by the system")
        for port in ports:
            echo(hanging(f"{port['device']:<{width}}", printable(port["description"])))
    for bus in buses:
        echo(f"CAN bus {bus.bus} ({bus.state})")
    echo("\ninstruments: bit rate, how well tested, supported commands")
    width = max(len(driver["name"]) for driver in drivers) + 2
    for driver in drivers:
        # A table of five columns would break every name at 80 columns.
        echo(hanging(f"{driver['name']:<{width}}", driver["title"]))
        told = ", ".join(f"{name}{'' if tried == _TRIED else '*'}" for name, tried in driver["abilities"].items())
        rate = f"{driver['default_baud']} bit/s" if driver["default_baud"] else ""
        echo(hanging(" " * width, "; ".join(filter(None, (rate, driver["status"], told)))))
    echo(hanging("", sentence("devices.document_only")))
    echo("\nimufield devices NAME shows one with its settings and wiring")


def _show(facts: dict[str, Any]) -> None:
    on_bus = facts["wire"] == "can"
    rows = {
        "driver": f"{facts['name']}; {facts['status']}",
        "wiring": facts["wiring"],
        "bit rate" if on_bus else "baud rate": f"{', '.join(map(str, facts['bauds']))} (the usual one first)",
        "commands": "; ".join(f"{ability} ({tried})" for ability, tried in facts["abilities"].items()) or "none",
        "manual": facts["manual"],
    }
    echo(printable(facts["title"]))
    for name, words in rows.items():
        echo(hanging(f"  {name:<11}", words))
    if facts["settings"]:
        echo("\nsettings, each as --set NAME=VALUE")
    for name, setting in facts["settings"].items():
        echo(f"  {name} = {setting['value']}".rstrip())
        for words in (setting["meaning"], setting["allowed"]):
            echo(hanging("      ", words))
    echo()
    # The tables of bytes are for whoever writes a driver; JSON has them.
    for paragraph in facts["about"].split("\n\n"):
        if "==" not in paragraph and not paragraph.rstrip().endswith(":"):
            echo(hanging("", paragraph.replace("``", "")))


def _describe(name: str, *, whole: bool = False) -> dict[str, Any]:
    """Return what is said of a driver, in JSON under the same names; ``whole`` with its wire and its settings."""
    try:
        driver = load_driver(name)
    except ProtocolError as error:
        # Drivers come from other packages too: a broken one must not hide the rest.
        return {"name": name, "title": error.message, "default_baud": "", "status": "cannot be loaded", "abilities": {}}
    facts = {
        "name": name,
        "title": driver.title,
        "default_baud": driver.default_baud,
        "status": driver.status,
        "abilities": {str(ability): str(tried) for ability, tried in driver.abilities.items()},
    }
    if not whole:
        return facts
    settings, rules = driver.load_protocol().settings, driver.load_protocol().rules
    told = {key: {"value": settings[key].value, "meaning": rules[key].help, "allowed": rules[key].allowed} for key in rules}
    wiring = sentence("devices.can" if driver.wire == "can" else "devices.serial", wiring=driver.wiring)
    of_wire = {"wire": driver.wire, "wiring": wiring, "bauds": driver.bauds, "manual": driver.manual}
    return facts | of_wire | {"settings": told, "about": inspect.getdoc(driver) or ""}
