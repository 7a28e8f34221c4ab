"""The figure of notebook 11 shows every printed number once, where its table has it."""

import numpy as np
import pytest
from matplotlib import pyplot

from studies import verdicts
from studies.figures import audit as figures
from studies.ou_liu_2017 import hypotheses
from studies.printed import judgement

from . import exported


def test_every_number():
    given = {"11_audit_gross_errors": hypotheses.gross_errors(hypotheses.gross_studies(60))}
    frame = verdicts.verdicts(judgement.Results(given))
    figures.every_number(frame)
    data = exported("11_audit_every_number")
    assert data["id"].tolist() == frame["id"].tolist()
    line = data[data["id"] == "ou_liu_2017/table1/ls/sigma_0"].iloc[0]
    assert line["half_widths"] == pytest.approx(
        (0.08004 - line["median"]) / (line["median"] - line["lower"])
    )
    marks = [
        mark
        for ax in pyplot.gcf().axes
        for mark in ax.lines
        if mark.get_marker() in {m for _, m, _, _ in figures.MARKS.values()}
    ]
    assert len(marks) == len(data) + len(figures._counts(data))  # each once, and the key
    crosses = [
        mark for mark in marks if mark.get_marker() == figures.MARKS[judgement.IMPOSSIBLE][1]
    ]
    assert len(crosses) == (frame["verdict"] == judgement.IMPOSSIBLE).sum() + 1
    assert np.isfinite([mark.get_xdata()[0] for mark in marks]).all()
