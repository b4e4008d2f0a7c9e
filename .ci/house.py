"""Figures of the house: rooms, arrows, words and lines of imufield and its drivers, measured from the text alone.

``python .ci/house.py`` prints the table and ends with 1 where a limit is passed; ``python .ci/house.py FOLDER ...`` prints the
figures of those folders only. Nothing of the project is imported.
"""

from __future__ import annotations

import ast
import io
import re
import string
import sys
import tokenize
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
CODE = ("imufield", "drivers")

# From the lowest room to the highest: an import may point to a room above it in this list, or into its own.
ROOMS = (
    ("version", "sentences", "limits", "dataclass"),
    ("errors",),
    ("progress",),
    ("samples", "earth", "files", "toml_and_json", "console", "campaign"),
    ("drawing",),
    ("acquire/background_work", "acquire/protocol"),
    ("acquire/decode",),
    ("acquire/clock",),
    ("acquire/decoder",),
    ("acquire/driver",),
    ("acquire/registry",),
    ("acquire/link",),
    ("acquire/recording",),
    ("acquire/formats",),
    ("acquire/instrument",),
    # Addresses that drivers and programs of others import.
    ("acquire", "acquire/exchange", "acquire/checksum", "acquire/can_logs"),
    ("drivers", "protocols"),
    ("calibrate/model",),
    ("calibrate/noise",),
    ("calibrate/solvers",),
    ("calibrate/accelerometer",),
    ("calibrate/moves",),
    ("calibrate/gyroscope",),
    ("calibrate/temperature",),
    ("calibrate/sessions",),
    ("calibrate",),
    ("guide/positions", "guide/events"),
    ("guide/refusals",),
    ("guide/stillness",),
    ("guide/hold",),
    ("guide/cross_checks",),
    ("guide/lead",),
    ("guide/view",),
    ("guide",),
    ("deliver/parameters",),
    ("deliver/exports",),
    ("deliver/navigation",),
    ("deliver/samples",),
    ("deliver/verification",),
    ("deliver/report",),
    ("deliver/certificate",),
    ("deliver",),
    ("",),
    ("simulate/truth",),
    ("simulate/wire",),
    ("simulate/instruments",),
    ("simulate/emulator",),
    ("simulate",),
    ("study",),
    ("study/answers",),
    ("pipeline",),
    ("web",),
    ("commands/options",),
    ("commands/terminal",),
    ("commands",),
    ("testing",),
    ("cli",),
    ("__main__",),
)
# Rooms beside each other: none of the left may import one of the right, although the list alone would let it.
APART = {
    "guide": ("drivers",),
    "calibrate": ("drivers",),
    "deliver": ("guide", "drivers"),
    "simulate": ("drivers",),
    "study": ("drivers",),
    "pipeline": ("simulate", "study", "drivers"),
    "cli": ("acquire", "calibrate", "guide", "deliver", "simulate", "study", "pipeline"),
}
# Folders with a file for each thing.
MANY_OF_A_KIND = ("commands", "deliver/exports", "study", "study/answers", "drivers", "protocols")
SETTINGS = ("GuideSettings",)
_KEY = re.compile(r"\w+\.\w+")  # Of a sentence: module and name.
_SECTION = re.compile(r"\w+\.")  # Its module.
POSITIONAL = 6  # From this number on, arguments without a name cannot be understood at the place of the call.


@dataclass(frozen=True)
class Module:
    """One file: its dotted name without ``imufield``, its room and its syntax tree."""

    path: Path
    name: str
    source: str
    tree: ast.Module

    @property
    def room(self) -> str:
        """The folder, or the file itself where it is directly in a folder that holds rooms."""
        parts = self.name.split(".") if self.name else []
        if self.path.name == "__init__.py":
            return "/".join(parts)
        above = "/".join(parts[:-1])
        return above if above and any(above in row for row in ROOMS) and "/".join(parts) not in _FLAT else "/".join(parts)


_FLAT = {room for row in ROOMS for room in row}


def modules(project: Path = PROJECT) -> list[Module]:
    """Return every module of imufield and its drivers."""
    found = []
    for path in sorted(path for folder in CODE for path in (project / folder).rglob("*.py")):
        parts = [part for part in path.relative_to(project).with_suffix("").parts if part != "__init__"]
        name = ".".join(parts[1:] if parts[0] == "imufield" else parts)
        source = path.read_text(encoding="utf-8")
        found.append(Module(path, name, source, ast.parse(source)))
    return found


def imports(module: Module, known: Iterable[str]) -> Iterator[str]:
    """Yield the modules of imufield that one imports: at its top, later, or for types only."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            top, _, rest = name.partition(".")
            if top != "imufield":
                continue
            yield rest if rest in known else rest.rpartition(".")[0]


def graph(found: list[Module]) -> dict[str, set[str]]:
    """Return what each module imports, by name."""
    known = {module.name for module in found}
    return {module.name: set(imports(module, known)) & known - {module.name} for module in found}


def circles(arrows: Mapping[str, set[str]]) -> list[list[str]]:
    """Return the sets of modules that import each other, however far around."""
    reach: dict[str, set[str]] = {}
    for begin in arrows:
        seen: set[str] = set()
        todo = list(arrows[begin])
        while todo:
            if (name := todo.pop()) not in seen:
                seen.add(name)
                todo += arrows[name]
        reach[begin] = seen
    rings = {frozenset(other for other in reach[name] if name in reach[other]) for name in arrows if name in reach[name]}
    return sorted(sorted(ring) for ring in rings)


def arrows_up(found: list[Module]) -> list[str]:
    """Return the imports that point to a higher room, or to one that stands apart."""
    level = {room: number for number, row in enumerate(ROOMS) for room in row}
    room = {module.name: module.room for module in found}
    wrong = []
    for name, targets in graph(found).items():
        for target in sorted(targets):
            here, there = room[name], room[target]
            # The package itself only says which version it is and hands out `load` and `find`.
            apart = any(there.split("/")[0] == other for other in APART.get(here.split("/")[0], ()))
            if here != there and (level[there] >= level[here] or apart):
                wrong.append(f"{name or 'imufield'} ({here}) -> {target or 'imufield'} ({there})")
    return wrong


def any_in_annotations(module: Module) -> int:
    """Count ``Any`` in annotations and in type aliases."""
    places: list[ast.expr | None] = []
    for node in ast.walk(module.tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = node.args
            every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
            places += [argument.annotation for argument in every if argument is not None]
            places.append(node.returns)
        elif isinstance(node, ast.AnnAssign):
            places.append(node.annotation)
    places += [
        node.value for node in module.tree.body if isinstance(node, ast.Assign) and isinstance(node.value, ast.Subscript)
    ]
    return sum(isinstance(part, ast.Name) and part.id == "Any" for place in places if place for part in ast.walk(place))


def positional_calls(found: list[Module]) -> list[str]:
    """Return the calls with many arguments without a name, of what imufield or a driver defines."""
    functions = ast.FunctionDef | ast.AsyncFunctionDef
    classes = [node for module in found for node in ast.walk(module.tree) if isinstance(node, ast.ClassDef)]
    methods = {node.name for owner in classes for node in owner.body if isinstance(node, functions)}
    plain = {node.name for module in found for node in ast.walk(module.tree) if isinstance(node, functions)} - methods
    known = {ast.Name: plain | {owner.name for owner in classes}, ast.Attribute: methods}
    return [
        f"{module.path.relative_to(PROJECT)}:{node.lineno}"
        for module in found
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Call) and len(node.args) >= POSITIONAL
        if _called(node) in known.get(type(node.func), set()) - _foreign(module)
    ]


def _foreign(module: Module) -> set[str]:
    """Return the names that a module has from other packages."""
    origins = [node for node in ast.walk(module.tree) if isinstance(node, ast.ImportFrom)]
    return {alias.name for node in origins if not (node.module or "").startswith("imufield") for alias in node.names}


def _called(call: ast.Call) -> str:
    return call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")


def unset_settings(found: list[Module]) -> list[str]:
    """Return the settings with a default that no call gives another value."""
    given = Counter(
        word.arg for module in found for node in ast.walk(module.tree) if isinstance(node, ast.Call) for word in node.keywords
    )
    return [
        f"{node.name}.{field.target.id}"
        for module in found
        for node in module.tree.body
        if isinstance(node, ast.ClassDef) and node.name in SETTINGS
        for field in node.body
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and field.value
        and not given[field.target.id]
    ]


def sentences_astray(found: list[Module]) -> list[str]:
    """Return keys and values in the code that a room's ``sentences.toml`` lacks, and sentences there that no code names.

    A string "section.", as an f-string begins, names those of its sentences whose names stand somewhere in the code.
    """
    astray = []
    constants = (node.value for module in found for node in ast.walk(module.tree) if isinstance(node, ast.Constant))
    words = {value for value in constants if isinstance(value, str)}
    folders: dict[Path, list[Module]] = defaultdict(list)
    for module in found:
        folders[module.path.parent].append(module)
    for folder, inside in folders.items():
        path = folder / "sentences.toml"
        table = tomllib.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        texts = {f"{section}.{name}": text for section, named in table.items() for name, text in named.items()}
        unnamed = set(texts)
        for module in inside:
            for node in ast.walk(module.tree):
                if isinstance(node, ast.Constant):
                    unnamed.discard(node.value)
                    if isinstance(node.value, str) and _SECTION.fullmatch(node.value):
                        unnamed -= {f"{node.value}{word}" for word in words}
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "sentence" and node.args:
                    place = f"{module.path.relative_to(PROJECT).as_posix()}:{node.lineno}"
                    astray += [f"{place} {what}" for what in _lacking(node, texts)]
        astray += [f"{path.relative_to(PROJECT).as_posix()} {key}: no code names it" for key in sorted(unnamed)]
    return astray


def _lacking(call: ast.Call, texts: Mapping[str, str]) -> Iterator[str]:
    given = {keyword.arg for keyword in call.keywords}
    constants = (node.value for node in ast.walk(call.args[0]) if isinstance(node, ast.Constant))
    keys = [value for value in constants if isinstance(value, str) and _KEY.fullmatch(value)]
    for key in keys:
        if key not in texts:
            yield f"{key}: no such sentence"
        elif None not in given:  # Not with ``**values``.
            named = {re.split(r"[.[]", name)[0] for _, name, _, _ in string.Formatter().parse(texts[key]) if name}
            yield from (f"{key}: {{{name}}} is not given" for name in sorted(named - given))


def lines(module: Module) -> tuple[int, int]:
    """Return the lines of code, without blanks, docstrings and comments, and the comments."""
    strings: set[int] = set()
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            strings.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    code: set[int] = set()
    comments = 0
    empty = (tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    for token in tokenize.generate_tokens(io.StringIO(module.source).readline):
        if token.type == tokenize.COMMENT:
            comments += 1
        elif token.type not in empty:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - strings), comments


def crowded(found: list[Module]) -> tuple[int, str]:
    """Return the most modules that one folder holds, and which; folders of many things of a kind aside."""
    count: dict[str, int] = defaultdict(int)
    for module in found:
        folder = module.path.parent.relative_to(PROJECT)
        if module.path.name != "__init__.py" and folder.as_posix().removeprefix("imufield/") not in MANY_OF_A_KIND:
            count[folder.as_posix()] += 1
    return max((number, folder) for folder, number in count.items())


def main(folders: list[str]) -> int:
    """Print the figures; return 1 where one passes its limit."""
    every = modules()
    roots = [Path(folder).resolve() for folder in folders] or [PROJECT]
    chosen = [module for module in every if any(module.path.is_relative_to(root) for root in roots)]
    counts = [lines(module) for module in chosen]
    code, comments = sum(code for code, _ in counts), sum(number for _, number in counts)
    most, where = crowded(every)
    mine = {module.path.relative_to(PROJECT).as_posix() for module in chosen}
    rings, up = circles(graph(every)), arrows_up(every)
    calls = [place for place in positional_calls(every) if place.rpartition(":")[0] in mine]
    unset = unset_settings(every)
    astray = sentences_astray(every)
    any_count = sum(any_in_annotations(module) for module in chosen)
    rows: list[tuple[str, float, float | None, Iterable[str]]] = [
        (f"modules in one folder ({where})", most, 14, ()),
        ("circles of imports", len(rings), 0, map(" <-> ".join, rings)),
        ("arrows that run up", len(up), 0, up),
        ("Any in annotations", any_count, 60, ()),
        (f"calls with {POSITIONAL} or more positional arguments", len(calls), 0, calls),
        ("settings that nothing sets", len(unset), 0, unset),
        ("sentences without a place, places without a sentence", len(astray), 0, astray),
        ("comments on 100 lines of code, at least", round(100 * comments / max(code, 1), 2), -5, ()),
        ("lines of code", code, None, ()),
    ]
    failed = False
    for title, value, limit, places in rows:
        beyond = limit is not None and (value > limit if limit >= 0 else value < -limit)
        failed |= beyond
        print(
            f"{title:58} {value:>8g}" + ("" if limit is None else f"   limit {abs(limit):g}") + ("   BEYOND" if beyond else "")
        )
        for place in list(places)[:40]:
            print(f"    {place}")
    return int(failed and not folders)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
