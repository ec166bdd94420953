"""What all programs with a command line do alike."""

import pytest

from tomotactile_ros.cli import main


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["simulat"], "simulate"),
        (["optimize", "--method", "papr"], "paper"),
        (["run", "--profle", "fast"], "--profile"),
        (["xyz"], ""),
    ],
)
def test_a_misspelt_name_is_answered_with_the_one_that_was_probably_meant(words, meant, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words)
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1
    assert (f"did you mean {meant}?" in said) if meant else ("did you mean" not in said)
