"""The covariance in a certificate is that of its own results: the covariance in the parameter file, propagated through them."""

from __future__ import annotations

import json
import math
import shutil
from copy import deepcopy
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from scipy.special import chdtri, fdtri

from imufield.cli.run import run
from imufield.deliver.certificate.certificate import Certificate, Parties, to_json
from imufield.deliver.certificate.dcc import to_xml
from imufield.deliver.parameters.file import from_document, load
from imufield.deliver.parameters.schema import Document
from imufield.samples import FloatArray

NAMES = {"": "https://ptb.de/si", "dcc": "https://ptb.de/dcc"}
STEP = 2.0**-10  # Results are linear in the parameters.


@pytest.fixture
def document(solved_session: Path) -> Document:
    return deepcopy(load(solved_session).document)


def certified(document: Document) -> Certificate:
    return Certificate(parameters=from_document(document), parties=Parties(), issued="2026-02-01")


def lists_of(document: Document) -> list[ET.Element]:
    root = ET.fromstring(to_xml(certified(document)))  # noqa: S314 - written by the program under test
    return root.findall(".//realListXMLList", NAMES)


def words(element: ET.Element, path: str) -> list[str]:
    return (element.findtext(path, namespaces=NAMES) or "").split()


def values_of(document: Document) -> FloatArray:
    """Return the values of all lists but the joint one, in SI."""
    return np.array([float(word) for each in lists_of(document)[:-1] for word in words(each, "valueXMLList")])


def matrix_of(joint: ET.Element) -> FloatArray:
    columns = joint.findall("ellipsoidalRegionXMLList/covarianceMatrix/column", NAMES)
    return np.array([[float(each.text or "") for each in column.iterfind("covariance/value", NAMES)] for column in columns]).T


def moved(document: Document, name: str, by: float) -> Document:
    """Return the parameter file with one of its parameters changed."""
    copy = deepcopy(document)
    triad, key, place = name.split(".")
    *rows, last = ("xyz".index(axis) for axis in place)
    numbers = copy[triad][key]
    for row in rows:
        numbers = numbers[row]
    numbers[last] += by
    return copy


def propagated(document: Document) -> FloatArray:
    """Return the covariance of the values, from that in the file and the clock, by differences of the values themselves."""
    names, C = document["covariance"]["names"], np.array(document["covariance"]["matrix"])
    at = values_of(document)
    gravity = np.zeros(len(at))  # Known by itself: no result is computed from it.
    columns = [gravity if name == "gravity_m_s2" else (values_of(moved(document, name, STEP)) - at) / STEP for name in names]
    J = np.column_stack(columns)
    faster = deepcopy(document)
    faster["gyroscope"]["scale"] = [scale * (1 + STEP) for scale in document["gyroscope"]["scale"]]
    by_clock = (values_of(faster) - at) / STEP * document["clock"]["sigma"]
    return np.asarray(J @ C @ J.T + np.outer(by_clock, by_clock))


@pytest.mark.parametrize("raw_units", [("m/s^2", "rad/s"), ("g", "count/s"), ("count", "count")])
def test_the_covariance_is_that_of_the_results(document: Document, raw_units: tuple[str, str]) -> None:
    document["accelerometer"]["raw_unit"], document["gyroscope"]["raw_unit"] = raw_units
    *apart, joint = lists_of(document)
    covariance = matrix_of(joint)
    uncertainty, factor = (
        np.array([float(word) for each in apart for word in words(each, f"expandedUncXMLList/{name}")])
        for name in ("uncertaintyXMLList", "coverageFactorXMLList")
    )
    sigma = uncertainty / factor
    np.testing.assert_allclose(np.diag(covariance), sigma**2, rtol=1e-9)
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(covariance / scale, propagated(document) / scale, atol=1e-7)
    np.testing.assert_array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance / scale)[0] > -1e-9
    # All of it is of no use where nothing is correlated.
    assert np.max(np.abs(np.tril(covariance / scale, -1))) > 0.3
    np.testing.assert_array_equal([float(word) for word in words(joint, "valueXMLList")], values_of(document))


def test_the_joint_list_has_the_documented_structure(document: Document) -> None:
    *_, joint = lists_of(document)
    assert [child.tag.partition("}")[2] for child in joint] == [
        "labelXMLList",
        "valueXMLList",
        "unitXMLList",
        "ellipsoidalRegionXMLList",
    ]
    assert [child.tag.partition("}")[2] for child in joint[-1]] == [
        "covarianceMatrix",
        "coverageFactor",
        "coverageProbability",
    ]
    parameters = [parameter for group in certified(document).groups for parameter in group.parameters]
    labels, units = words(joint, "labelXMLList"), words(joint, "unitXMLList")
    assert labels == [parameter.name for parameter in parameters]
    assert len(units) == len(labels) == len(matrix_of(joint))
    # The unit of a covariance is the product of both.
    cells = {
        (labels[column], labels[row]): cell.text
        for column, each in enumerate(joint.iterfind(".//column", NAMES))
        for row, cell in enumerate(each.iterfind("covariance/unit", NAMES))
    }
    force, one = "accelerometer.bias_m_s2.x", "accelerometer.misalignment_rad.yx"
    assert cells[force, force] == r"\metre\tothe{2}\second\tothe{-4}"
    assert cells[one, one] == r"\radian\tothe{2}"
    assert cells[force, one] == r"\radian\metre\second\tothe{-2}"
    # Coverage of the region: between that of as good as infinitely many degrees of freedom and that of the fewest.
    k = float(joint.findtext(".//coverageFactor", namespaces=NAMES) or "nan")
    n, fewest = len(labels), min(parameter.degrees_of_freedom for parameter in parameters)
    assert k == pytest.approx(math.sqrt(n * fdtri(n, fewest, 0.95)), rel=1e-5)
    assert k > math.sqrt(chdtri(n, 0.05))


def test_the_region_has_as_many_dimensions_as_are_free(whole_session: Path, tmp_path: Path) -> None:
    shutil.copytree(whole_session, tmp_path / "session")
    solve = ["solve", str(tmp_path / "session"), "--latitude", "48", "--gauge"]
    factors, labels = [], []
    for gauge in ("lower", "symmetric"):
        assert run([*solve, gauge]) == 0
        *_, joint = lists_of(load(tmp_path / "session").document)
        factors.append(float(joint.findtext(".//coverageFactor", namespaces=NAMES) or "nan"))
        labels.append(words(joint, "labelXMLList"))
    # Six misalignments in place of three, of which three are free: it is the same region.
    assert len(labels[1]) == len(labels[0]) + 3
    assert factors[1] == pytest.approx(factors[0], rel=0.01)


def test_the_json_has_the_covariance_of_its_budget(document: Document) -> None:
    written = json.loads(json.dumps(to_json(certified(document)), allow_nan=False))
    covariance = np.array(written["covariance"])
    sigma = [parameter["standard_uncertainty"] for parameter in written["budget"]]
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sigma, rtol=1e-9)
    names, C = document["covariance"]["names"], np.array(document["covariance"]["matrix"])
    rows = [names.index(parameter["name"]) for parameter in written["budget"]]
    # Beside the covariance of the file stands the time base, common to the gyroscope's scales.
    beyond = covariance - C[np.ix_(rows, rows)]
    is_scale = [parameter["name"].startswith("gyroscope.scale") for parameter in written["budget"]]
    scales = np.array([parameter["value"] for parameter in written["budget"]]) * is_scale * document["clock"]["sigma"]
    np.testing.assert_allclose(beyond / np.outer(sigma, sigma), np.outer(scales, scales) / np.outer(sigma, sigma), atol=1e-9)


def test_without_degrees_of_freedom_there_is_no_region(document: Document) -> None:
    del document["budget"]
    document["quality"]["student_factor_95"] = math.nan
    assert not [each for each in lists_of(document) if each.find("ellipsoidalRegionXMLList", NAMES) is not None]
    json.dumps(to_json(certified(document)), allow_nan=False)
