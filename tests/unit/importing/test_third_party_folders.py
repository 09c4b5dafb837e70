"""Folders of files, and signs that a line states in words of other languages."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows, prepared

COMMANDED_FIRST = [
    "Nota: scostamento = quota nominale meno quota misurata",
    "desvio = posição alvo menos posição medida",
    "Écart = cote visée moins cote mesurée",
    "Desviación = posición teórica - posición real",
    "odchyłka = pozycja zadana minus pozycja zmierzona",
    "Not: sapma = hedef konum eksi ölçülen konum",
    "отклонение = заданное положение минус измеренное положение",
    "afwijking = gewenste positie - gemeten positie",
    "说明：误差＝理论值－测量值",
    "편차 = 목표위치 - 실측위치",
    "Abweichung: Soll abzüglich Ist",
]
ACTUAL_FIRST = [
    "scostamento = posizione misurata - posizione nominale",
    "Desvio = valor medido - valor nominal",
    "Odchyłka = wartość zmierzona - wartość zadana",
    "Sapma: ölçülen değer - hedef değer",
    "avvik = målt verdi - nominell verdi",
]
UNKNOWN = [
    "Errore: differenza tra quota nominale e quota reale",
    "Note: deviation = nominal value subtracted from actual value",
    "Odchyłka = odczyt - wzorzec",
    "Nota: desvio = A menos B",
]


def stating(tmp_path: Path, line: str) -> Path:
    """One run from below, so that no lost motion contradicts a wrong sign."""
    rows = [f"{x:g};{d:g}" for x, d in zip(TARGETS, deviation(1, 1.0), strict=True)]
    (tmp_path / "f.csv").write_text("\n".join([line, "Target X [mm];Deviation [um]", *rows]), encoding="utf-8")
    return tmp_path / "f.csv"


@pytest.mark.parametrize("sign, line", [*((-1.0, t) for t in COMMANDED_FIRST), *((1.0, t) for t in ACTUAL_FIRST)])
def test_a_sign_in_words_of_another_language(tmp_path: Path, sign: float, line: str) -> None:
    """Nouns before adjectives were not read: `quota nominale meno quota misurata` kept the opposite sign."""
    recording = imported(tmp_path, stating(tmp_path, line))
    (error,) = recording.names("error", component="EXX")
    assert np.allclose(recording.array(error), sign * deviation(1, 1.0))


@pytest.mark.parametrize("line", UNKNOWN)
def test_a_definition_of_unknown_quantities_is_asked_for(tmp_path: Path, line: str) -> None:
    with pytest.raises(DataError, match=r"--sign"):
        imported(tmp_path, stating(tmp_path, line))


@pytest.mark.parametrize("line", ["Deviation = 3 - 5 um", "Compensation: none", "Error: X axis - forward"])
def test_other_lines_about_deviations_ask_nothing(tmp_path: Path, line: str) -> None:
    recording = imported(tmp_path, stating(tmp_path, line))
    assert np.allclose(recording.array(recording.names("error")[0]), deviation(1, 1.0))
