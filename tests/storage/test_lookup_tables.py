"""Exported tables: the C compiles without a warning and says what the service says."""

import ctypes
import re
import shutil
import subprocess
from itertools import product

import blark.parse
import numpy as np
import pytest

from support.exported_maps import COARSE, FINE, PART, dead_band, exported_map
from support.soaked import soaked
from support.structured_text import FunctionBlock
from valvemap.errors import ConfigurationError, StorageError
from valvemap.model.flow_map import FlowMap
from valvemap.model.inverse_map import invert
from valvemap.model.linear_map import LinearMap, LinearMapState
from valvemap.model.lookup_table import LookupTable, lookup_table
from valvemap.model.model_structures import FiveTerms
from valvemap.storage.lookup_tables import as_c, write_table
from valvemap.storage.structured_text import as_structured_text
from valvemap.vocabulary.statuses import InverseStatus


@pytest.fixture(
    scope="module",
    params=[
        ("eq. (7)", COARSE),
        ("network", FINE),
        ("auto", COARSE),
        *soaked(*(((name, FINE),) for name in ("eq. (7)", "spline", "auto"))),
    ],
    ids=str,
)
def exported(request):
    return exported_map(*request.param)


def compiled(table, folder, *more):
    """The exported function, compiled with all warnings as errors."""
    gcc = shutil.which("gcc") or shutil.which("cc")
    if gcc is None:
        pytest.skip("no C compiler here")
    source, made, library = folder / "map.c", folder / "map.o", folder / "map.so"
    write_table(source, table, "Valvistor */ by RLS")
    options = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-fPIC", *more]
    subprocess.run([gcc, *options, "-c", source, "-o", made], check=True)
    subprocess.run(
        [gcc, "-shared", made, "-o", library], check=True
    )  # no change of the process's rounding
    function = ctypes.CDLL(str(library)).valvemap_required_U
    function.argtypes = [ctypes.c_double, ctypes.c_double, ctypes.POINTER(ctypes.c_double)]

    def ask(Q, dp):
        U = ctypes.c_double(np.nan)
        status = function(Q, dp, ctypes.byref(U))
        return U.value, status

    return ask


def test_the_compiled_table_is_within_its_stated_error_of_the_services_inverse(exported, tmp_path):
    estimator, state, table = exported
    ask = compiled(table, tmp_path)
    rng = np.random.default_rng(5)
    Q, dp = rng.uniform(0, 220, 5000), rng.uniform(5, 200, 5000)
    answers = np.array([ask(*point) for point in zip(Q, dp, strict=True)])
    U, status = answers[:, 0], answers[:, 1].astype(int)
    mine, codes = table.interpolate(Q, dp)
    np.testing.assert_allclose(U, mine, atol=1e-6, equal_nan=True)
    assert np.mean(status == codes) > 0.999
    exact = invert(estimator, state, Q, dp, 40.0)
    both = np.isfinite(U) & np.isfinite(exact.U)
    assert both.mean() > 0.95
    assert np.abs(U - exact.U)[both].max() <= table.error_U
    assert ("certified" in as_structured_text(table, "V")) == table.certified
    T = np.full(int(both.sum()), 40.0)
    demand = np.clip(Q, *(np.interp(dp, table.dp, x) for x in (table.lowest, table.highest)))
    flow = estimator.predict(state, U[both], dp[both], T)[0]
    assert np.abs(flow - demand[both]).max() <= table.error_Q
    assert table.error_U < 10.0  # a dead band is a jump of that size
    assert table.error_Q < 2.0
    inside = both & (exact.lower > 1.0) & (exact.upper < 99.0)
    assert (status[inside] == InverseStatus.OK).mean() > 0.98


def test_outside_the_axes_and_for_no_numbers_the_compiled_table_says_so(exported, tmp_path):
    _, _, table = exported
    ask = compiled(table, tmp_path)
    assert ask(50.0, 1.0)[1] == InverseStatus.OUTSIDE
    assert ask(50.0, 1.0)[0] == pytest.approx(ask(50.0, 5.0)[0])
    assert ask(1e9, 100.0) == (100.0, InverseStatus.ABOVE_REACH)
    assert ask(-1e9, 100.0) == (0.0, InverseStatus.BELOW_REACH)
    for point in ((np.nan, 50.0), (50.0, np.inf), (-np.inf, np.nan)):
        U, status = ask(*point)
        assert status == InverseStatus.NOT_FINITE
        assert np.isnan(U)


NO_NUMBERS = (np.nan, -np.nan, np.inf, -np.inf)
ODD = (*NO_NUMBERS, 1e308, -1e308, 5e-324, -5e-324, 0.0, -0.0)
FLAT = np.array([0.0, 0.5, 1.0])
UNDETERMINED = LookupTable(
    10 * FLAT, FLAT, FLAT, FLAT, 100 * np.eye(3), np.eye(3) > 1.0, 40.0, 0.1, 0.1
)


@pytest.mark.parametrize("options", [["-O0"], ["-O2", "-ffast-math"]], ids=" ".join)
def test_the_compiled_table_never_gives_no_number_with_status_0(exported, options, tmp_path):
    for number, table in enumerate((exported[2], UNDETERMINED)):
        (tmp_path / str(number)).mkdir()
        ask = compiled(table, tmp_path / str(number), *options)
        for Q, dp in product((*ODD, 50.0), (*ODD, 5.0, 100.0)):
            U, status = ask(Q, dp)
            is_no_number = not np.isfinite(Q) or not np.isfinite(dp)
            assert (status == InverseStatus.NOT_FINITE) == is_no_number, (Q, dp)
            assert np.isfinite(U) or status != InverseStatus.OK, (Q, dp)


def test_the_structured_text_never_gives_no_number_with_status_0(exported):
    for table in (exported[2], UNDETERMINED):
        run = FunctionBlock(as_structured_text(table, "V"))
        for Q, dp in product((*ODD, 50.0), (*ODD, 5.0, 100.0)):
            found = run(Q=Q, dp=dp)
            if {Q, dp} & set(NO_NUMBERS) or Q != Q or dp != dp:  # noqa: PLR0124 - NaN
                assert found["status"] == InverseStatus.NOT_FINITE, (Q, dp)
            assert np.isfinite(found["u"]) or found["status"] != InverseStatus.OK, (Q, dp)


def test_where_the_map_is_not_known_the_compiled_table_gives_no_U(tmp_path):
    axis = np.array([0.0, 0.5, 1.0])
    U = np.array([[0.0, 10.0, 20.0], [50.0, np.nan, 60.0], [90.0, 90.0, 100.0]])
    known = np.zeros(U.shape, bool)
    table = LookupTable(10 * axis, 0 * axis, np.full(3, 20.0), axis, U, known, 40.0, 0.1, 0.1)
    ask = compiled(table, tmp_path)
    assert ask(5.0, 2.5)[1] == InverseStatus.UNIDENTIFIED
    assert np.isnan(ask(5.0, 2.5)[0])
    assert table.interpolate(np.array([5.0]), np.array([2.5]))[1] == [InverseStatus.UNIDENTIFIED]


@pytest.mark.parametrize("name", ["auto", *soaked("eq. (7)")])
def test_where_nothing_was_measured_every_form_of_the_table_says_extrapolating(name, tmp_path):
    table = exported_map(name, COARSE, PART).inverse
    assert 0.4 < table.guessed.mean() < 1.0
    ask, run = compiled(table, tmp_path), FunctionBlock(as_structured_text(table, "V"))
    inside, outside = (dead_band(20.0, 30.0), 30.0), (dead_band(30.0, 150.0), 150.0)
    for point, expected in ((inside, 0), (outside, 7), ((1e3, 150.0), 7)):
        status = table.interpolate(*np.array(point).reshape(2, 1))[1]
        assert [status[0], ask(*point)[1], run(Q=point[0], dp=point[1])["status"]] == [expected] * 3


BLOCKS = ("FUNCTION_BLOCK", "VAR", "IF", "WHILE")


def test_the_structured_text_is_well_formed(exported):
    table = exported[2]
    text = as_structured_text(table, "Valvistor (* by *) RLS")
    code = re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL)
    assert "(*" not in code
    assert "*)" not in code
    words = re.findall(r"[A-Za-z_]+", code)
    opens = {"FUNCTION_BLOCK": 1, "VAR": 3, "IF": 9, "WHILE": 2}
    for block, n in opens.items():
        starts = [w for w in words if w == block or (block == "VAR" and w.startswith("VAR"))]
        assert len(starts) == n, block
        assert words.count(f"END_{block}") == n, block
    assert words.count("THEN") == words.count("IF") + words.count("ELSIF")
    assert code.count("(") == code.count(")")
    assert code.count("[") == code.count("]")
    declared = {m[1] for m in re.finditer(r"^    (\w+) : ", code, re.MULTILINE)}
    used = set(re.findall(r"\b(?:[A-Za-z]\w*)\b", code.split("END_VAR")[-1]))
    keywords = {"IF", "THEN", "ELSE", "ELSIF", "OR", "AND", "NOT", "e300", "DO", "WHILE", "LIMIT"}
    assert used - keywords - {f"END_{b}" for b in BLOCKS} <= declared
    for name, values in (
        ("AxisR", table.r),
        ("AxisDp", table.dp),
        ("Lowest", table.lowest),
        ("Highest", table.highest),
        ("TableU", table.U.ravel()),
    ):
        size, listed = re.search(
            rf"{name} : ARRAY\[0\.\.(\d+)\] OF LREAL := \[(.*?)\]", code, re.DOTALL
        ).groups()
        numbers = [float(x) for x in listed.split(",")]
        assert int(size) + 1 == len(numbers) == len(values)
        np.testing.assert_allclose(
            numbers, np.nan_to_num(values, nan=-1000.0), rtol=1e-8, atol=1e-8
        )
        assert all("." in x for x in listed.split(","))


def test_a_parser_of_the_standard_takes_the_structured_text_and_none_with_a_slip():
    """A small table, because blark's grammar is slow."""
    axis = np.array([0.0, 0.5, 1.0])
    U, known = 100 * np.eye(3), np.eye(3) > 1.0
    table = LookupTable(10 * axis, axis, 9 + axis, axis, U, known, 40.0, 0.1, 0.1)
    text = as_structured_text(table, "V")
    assert blark.parse.parse_source_code(text).exception is None
    for right, wrong in (("END_IF;", "END_FI;"), ("THEN", ""), ("END_VAR", "")):
        assert blark.parse.parse_source_code(text.replace(right, wrong, 1)).exception is not None


def test_the_structured_text_computes_what_the_table_says(exported):
    """As blark reads it, and by the standard's rules (`support/structured_text.py`)."""
    table = exported[2]
    run = FunctionBlock(as_structured_text(table, "V"))
    rng = np.random.default_rng(6)
    Q, dp = rng.uniform(-5, 220, 300), rng.uniform(2, 220, 300)
    U, status = table.interpolate(Q, dp)
    for k in range(300):
        found = run(Q=float(Q[k]), dp=float(dp[k]))
        if not np.isnan(U[k]):
            assert found["u"] == pytest.approx(U[k], abs=1e-6)
        assert found["status"] == status[k] or abs(U[k] % 100.0) < 1e-6


def test_a_table_is_written_in_the_form_of_its_name(exported, tmp_path):
    table = exported[2]
    for name, start in (("a.c", "/* V"), ("a.st", "(* V"), ("b.ST", "(* V")):
        write_table(tmp_path / name, table, "V")
        assert (tmp_path / name).read_text(encoding="utf-8").startswith(start)
    with pytest.raises(
        ConfigurationError, match=r"a\.xlsx: \.xlsx; \.csv, \.c, \.st, \.fmu are allowed"
    ):
        write_table(tmp_path / "a.xlsx", table, "V")
    with pytest.raises(StorageError, match=r"nowhere"):
        write_table(tmp_path / "nowhere" / "a.c", table, "V")
    assert as_c(table, "V").count("{") == as_c(table, "V").count("}")


def test_a_table_needs_axes_and_a_map():
    known = LinearMap(FiveTerms()), LinearMapState(np.array([0, 0, 0, 0.1, 0.0]), np.zeros((5, 5)))
    for wrong in ({"dp_min": 0.0}, {"dp_min": 300.0}, {"points": (1, 5)}):
        with pytest.raises(ValueError, match="a table of"):
            lookup_table(*known, **wrong)
    nothing = LinearMap(FiveTerms())
    both = FlowMap(U_range=(-100.0, 100.0))
    with pytest.raises(ValueError, match=r"covers U from -100 to 100 %.*learn one direction alone"):
        lookup_table(both, both.initial_state())
    with pytest.raises(ValueError, match="not determined"):
        lookup_table(nothing, nothing.initial_state())
