"""Kernels that several processes of tests would compile are compiled once, before them."""

from support import kernels
from valvemap.model.kernels import warmed_up


def test_an_installation_has_compiled_no_part_and_a_run_of_the_tests_all(monkeypatch, tmp_path):
    compiled = []
    monkeypatch.setattr(warmed_up, "_note", lambda: tmp_path / "warmed-up")
    monkeypatch.setattr(kernels, "warm_up", lambda _: warmed_up.note_warm_up())
    monkeypatch.setattr(kernels, "compile_parts", lambda: compiled.append("all"))
    warmed_up.note_warm_up()  # as `make install` does
    kernels.main()
    kernels.main()
    assert compiled == ["all"]
    monkeypatch.setattr(warmed_up, "_stamp_of_all", lambda: "of other kernels")
    kernels.main()
    assert compiled == ["all", "all"]
