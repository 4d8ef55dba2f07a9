import numpy as np
import pandas as pd
import pytest

from benchmark import verify_maps
from benchmark.labels import LABELS, LabelledPoses
from benchmark.verify_maps import VerifiedMap, metrics_over_construction, report, scores, store, verify
from richmap.robots import load_robot


def labelled(n=400, seed=0):
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(n, 4)).astype(np.float32)
    truth = rng.random((3, n)) < 0.4
    positions = rng.random((n, 3)).astype(np.float32)
    return LabelledPoses(positions, quaternions, *truth, np.full(n, 4, dtype=np.uint8), {"uniform": n})


def a_map(name="richmap", reachable=lambda p, r: p[:, 0] < 0.5, **changes):
    about = {"cell_size": 0.05, "inserted": 900, "occupancy": 0.3, "insertion_rate": 0.1, "build_s": 3.0}
    about |= {"bytes_memory": 10, "bytes_disk": 20, "cells": 100}
    return VerifiedMap(name, reachable, **(about | changes))


def test_scores_are_those_of_the_confusion_matrix():
    truth = np.array([True] * 6 + [False] * 4)
    predicted = np.array([True, True, True, False, True, True, True, False, False, False])
    row = scores(predicted, truth)
    assert row["accuracy"] == pytest.approx(0.8) and row["tpr"] == pytest.approx(5 / 6)
    assert row["fpr"] == pytest.approx(1 / 4) and (row["n"], row["n_reachable"]) == (10, 6)
    assert row["fpr_low"] < row["fpr"] < row["fpr_high"]
    assert np.isnan(scores(predicted[:6], truth[:6])["fpr"])


def test_every_set_and_label_has_a_row_with_what_is_relied_on(monkeypatch):
    monkeypatch.setattr(verify_maps, "BATCHES", (100, 10_000, 1000))
    rows = verify(load_robot("panda"), a_map(), {"paper": labelled(), "hard": labelled(seed=1)})
    assert [(r["test_set"], r["labels"]) for r in rows] == [(s, k) for s in ("paper", "hard") for k in LABELS]
    names = (
        "robot map cell_size test_set labels n accuracy tpr fpr inserted occupancy avg_per_cell insertion_rate build_s"
    )
    assert set(f"{names} bytes_memory bytes_disk query_1e2_s".split()) <= set(rows[0])
    assert rows[0]["avg_per_cell"] == pytest.approx(900 / 30)


def test_a_row_replaces_an_older_one_about_the_same(tmp_path):
    file, key = tmp_path / "t.parquet", ["robot", "map"]
    store(file, [{"robot": "a", "map": "x", "v": 1}, {"robot": "b", "map": "x", "v": 2}], key)
    table = store(file, [{"robot": "a", "map": "x", "v": 3}, {"robot": "a", "map": "y", "v": 4}], key)
    assert table.v.tolist() == [3, 4, 2] and pd.read_parquet(file).equals(table)


def test_the_report_puts_our_figures_beside_the_papers(tmp_path):
    rows = verify(load_robot("panda"), a_map(inserted=11_250_000), {"paper": labelled()})
    store(
        tmp_path / "verify_labels.parquet",
        [{"robot": "panda", "test_set": "paper", "robot_fingerprint": "f"}],
        ["robot"],
    )
    report(tmp_path, store(tmp_path / "verify_maps.parquet", rows, verify_maps.KEY))
    text = (tmp_path / "verify_maps.md").read_text()
    assert "11.3 / 11.2" in text and ".037" in text and "164.1 / –" in text


def test_metrics_follow_a_map_under_construction():
    poses = labelled()
    growing = (a_map(inserted=i, reachable=lambda p, r, i=i: p[:, 0] < i / 4) for i in (1, 2, 3))
    curve = metrics_over_construction(growing, poses)
    assert curve.inserted.tolist() == [1, 2, 3] and (curve.tpr.diff().dropna() > 0).all()


def test_the_figure_is_drawn(tmp_path):
    curve = metrics_over_construction([a_map(inserted=i) for i in (1, 2)], labelled())
    verify_maps.draw_metrics({"panda": curve}, tmp_path / "metrics.png")
    assert (tmp_path / "metrics.png").stat().st_size > 1000
