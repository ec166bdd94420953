"""What all programs with a command line do alike."""

import os

import pytest

from tomotactile_ros.cli import main
from tomotactile_ros.support import checks


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["simulat"], "simulate"),
        (["optimize", "--method", "papr"], "paper"),
        (["run", "--profle", "fast"], "--profile"),
        (["layout", "--out", "x.yaml", "--margin", "0.01"], ""),
        (["layout", "--out", "x.yaml", "--columns", "4"], "--cols"),
        (["xyz"], ""),
    ],
)
def test_a_misspelt_name_is_answered_with_the_one_that_was_probably_meant(words, meant, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words)
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1
    assert (f"did you mean {meant}?" in said) if meant else ("did you mean" not in said)


def test_nodes_are_listed_where_they_can_be_started(monkeypatch, capsys):
    monkeypatch.setenv("TOMOTACTILE_NODES", "driver skin")
    for words in (["--help"], ["driv"]):
        with pytest.raises(SystemExit):
            main(words)
        assert "driver skin" in "".join(capsys.readouterr())


@pytest.mark.parametrize("words", [["--help"], ["run", "--help"]])
def test_a_reader_of_the_help_may_have_had_enough(words, monkeypatch, tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "w", encoding="utf-8") as out:
        monkeypatch.setattr("sys.stdout", out)
        with pytest.raises(SystemExit) as ended:
            main(words)
    assert ended.value.code == 141


@pytest.mark.parametrize(
    "value, said",
    [(412.3, "412"), (1e4, "10000"), (5630.0, "5630"), (2.5e-5, "0.000025"), (1e13, "1e+13")],
)
def test_numbers_are_written_as_people_do(value, said):
    assert checks.plain(value) == said
    assert checks.size(4.1e14) == "410 TB" and checks.size(1e6 - 1) == "1000 kB"
