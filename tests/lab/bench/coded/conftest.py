"""Photos of the coded table and estimators in the place of slow ones."""

from functools import partial

import pytest
from coded_table import Guesses, blocks

from cep.files.images import write_image
from lab.bench.coded import protocol
from motdiff.motions import boracchi_foi


@pytest.fixture
def guesses(monkeypatch):
    made = Guesses()
    monkeypatch.setattr("lab.evaluation.methods.named_estimators", made)
    return made


@pytest.fixture
def coarse_walks(monkeypatch):
    """Random walks of 100 points instead of 2000: the table's other parts do not depend on it, and
    their time does."""
    monkeypatch.setattr(protocol, "boracchi_foi", partial(boracchi_foi, samples=100))


@pytest.fixture
def photos(tmp_path, coarse_walks):
    write_image(tmp_path / "blocks.png", blocks(96), gamma="linear")
    return {"blocks": tmp_path / "blocks.png"}
