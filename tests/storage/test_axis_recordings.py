"""Recordings of axes: columns by name, separators, several axes, one line for a mistake."""

import numpy as np
import pytest

from valvemap.errors import NoRecording, RecordingError
from valvemap.storage.axis_recordings import read_axes

ROWS = "0.00,1,400,50,60,180,2,40\n0.01,-2,401,51,61,179,,40\n"


def written(tmp_path, text, name="axis.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_columns_go_by_their_names_and_others_are_ignored(tmp_path):
    path = written(tmp_path, "t,u,Position,pA,pB,pP,pT,Motor\n" + ROWS)
    (samples,) = read_axes(path).values()
    assert samples.t.tolist() == [0, 10_000_000]
    assert samples.U.tolist() == [1, -2]
    assert samples.x.tolist() == [400, 401]
    assert samples.pS.tolist() == [180, 179]
    assert np.isnan(samples.pT[1])
    assert np.isnan(samples.T).all()


def test_a_speed_counts_where_there_is_no_position(tmp_path):
    (samples,) = read_axes(written(tmp_path, "t,U,Speed,pA,pB,pS,pT,T\n" + ROWS)).values()
    assert samples.v.tolist() == [400, 401]
    assert np.isnan(samples.x).all()
    (samples,) = read_axes(written(tmp_path, "t,v,x,pA,pB,pS,pT,T\n" + ROWS)).values()
    assert np.isnan(samples.v).all()


def test_a_semicolon_and_decimal_commas_are_the_same_recording(tmp_path):
    plain = written(tmp_path, "t,U,x,pA,pB,pS,pT,T\n" + ROWS)
    german = written(
        tmp_path, "t;U;x;pA;pB;pS;pT;T\n" + ROWS.replace(",", ";").replace(".", ","), "g.csv"
    )
    one, other = read_axes(plain)["Axis"], read_axes(german)["Axis"]
    for name in ("t", "U", "x", "pA", "pB", "pS", "pT", "T"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


def test_a_heading_may_state_a_unit(tmp_path):
    plain = written(tmp_path, "t,U,x,pA,pB,pS,pT,T\n" + ROWS)
    heads = "t,U [%],x [m],pA (kPa),pB [bar],pS [MPa],pT,T [K]\n"
    rows = "0.00,1,.4,5000,60,18,2,313.15\n0.01,-2,.401,5100,61,17.9,,313.15\n"
    one, other = read_axes(plain)["Axis"], read_axes(written(tmp_path, heads + rows, "u.csv"))
    for name in ("U", "x", "pA", "pB", "pS", "pT", "T"):
        np.testing.assert_allclose(getattr(other["Axis"], name), getattr(one, name), rtol=1e-12)


def test_several_axes_are_told_apart(tmp_path):
    path = written(tmp_path, "t,valve,U,x\n0,Boom,1,2\n0,Arm,3,4\n1,Boom,5,6\n")
    axes = read_axes(path)
    assert axes["Boom"].U.tolist() == [1, 5]
    assert axes["Arm"].x.tolist() == [4]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("U,x\n1,2\n", "no column t; an axis needs t,U,x,pA,pB,pS,pT and has U,x"),
        ("t,U,x [yd]\n1,2,3\n", r"line 1: 'x \[yd\]': mm, cm, m, µm, in is allowed"),
        ("t,U,pA [mm]\n1,2,3\n", r"'pA \[mm\]': a unit of that quantity is allowed"),
        ("t,U,u\n1,2,3\n", "two columns are U: u is the second"),
        ("t,U\n1,2,3\n", "line 2: 3 cells, the header has 2"),
        ("t,U\n1,two\n", "line 2: .*U.*two"),
        ("t,U\n", "holds no samples"),
        ("", "no column t"),
    ],
)
def test_a_mistake_is_one_line_with_its_place(tmp_path, text, sentence):
    with pytest.raises(RecordingError, match=sentence) as caught:
        read_axes(written(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_foreign_one_are_refused(tmp_path):
    with pytest.raises(NoRecording, match="does not exist"):
        read_axes(tmp_path / "none.csv")
    with pytest.raises(NoRecording, match="ends in"):
        read_axes(tmp_path / "axis.xlsx")
