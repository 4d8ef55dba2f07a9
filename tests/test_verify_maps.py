from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from benchmark.artifacts.outputs import store_rows
from benchmark.map_quality import verify_maps
from benchmark.map_quality.labels import LABELS, LabelledPoses
from benchmark.map_quality.verify_config import VerifyMapsConfig
from benchmark.map_quality.verify_maps import VerifiedMap, confusion, half_and_half, report, scores, verify
from richmap.maps.reachability_map import Reach
from richmap.robots.robots import load_robot

pytestmark = pytest.mark.system


def labelled(n=400, seed=0):
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(n, 4)).astype(np.float32)
    truth = rng.random((3, n)) < 0.4
    positions = rng.random((n, 3)).astype(np.float32)
    return LabelledPoses(positions, quaternions, *truth, np.full(n, 4, dtype=np.uint8), {"uniform": n})


def a_map(name="richmap", reachable=lambda p, r: p[:, 0] < 0.5, **changes):
    about = {"cell_size": 0.05, "inserted": 900, "occupancy": 0.3, "insertion_rate": 0.1, "build_s": 3.0}
    about |= {"bytes_memory": 10, "bytes_disk": 20, "cells": 100, "made": "{}"}
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


def test_the_papers_set_is_half_and_half_under_every_label():
    poses = labelled()
    kind = np.where(poses.strict, 0, np.arange(len(poses)) % 5).clip(max=3).astype(np.uint8)  # 0 is reachable
    kind[~poses.strict & (kind == 0)] = 3
    poses = replace(poses, kind=kind, loose=poses.loose | poses.strict)
    kept = half_and_half(poses, "loose")
    count = np.bincount(kind[kept], minlength=4)
    assert poses.loose[kept].sum() == count[0] == pytest.approx(count[1:].sum(), abs=2) and count[0] > 20
    assert count[1:] / count[1:].sum() == pytest.approx([0.2, 0.2, 0.6], abs=0.02)
    assert len(half_and_half(labelled(), "loose")) == 400


def test_the_report_puts_our_figures_beside_the_papers(tmp_path):
    rows = verify(load_robot("panda"), a_map(inserted=11_250_000), {"paper": labelled()})
    labels = pd.DataFrame([{"robot": "panda", "test_set": "paper", "robot_fingerprint": "f"}])
    store_rows(tmp_path / "verify_labels.parquet", labels, ["robot"])
    report(tmp_path, store_rows(tmp_path / "verify_maps.parquet", pd.DataFrame(rows), verify_maps.KEY))
    text = (tmp_path / "verify_maps.md").read_text()
    assert "11.3 / 11.2" in text and ".037" in text and "164.1 / –" in text


def test_a_lower_threshold_never_makes_fewer_hits_and_the_curve_passes_through_the_map(tmp_path):
    poses, score = labelled(), lambda p, r: p[:, 0]
    half = a_map("fraction", lambda p, r: p[:, 0] >= 0.5, score=score)
    curve = pd.DataFrame(verify_maps.threshold_curve(load_robot("panda"), half, {"hard": poses, "paper": poses}))
    hard = curve[curve.test_set == "hard"]
    assert (hard.tpr.diff().dropna() <= 0).all() and (hard.fpr.diff().dropna() <= 0).all()
    at_half = hard[hard.threshold == 0.5].iloc[0]
    assert at_half.accuracy == scores(half.reachable(poses.positions, None), poses.strict)["accuracy"]
    rows = [{"robot": "panda", "map": "fraction", "cell_size": 0.05, "test_set": "hard", "labels": "strict"}]
    verify_maps.draw_curves(curve, pd.DataFrame([{**rows[0], "fpr": 0.1, "accuracy": 0.9}]), tmp_path)
    assert (tmp_path / "verify_curves.png").stat().st_size > 1000


def test_labels_are_checked_once(tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(
        "benchmark.map_quality.label_errors.label_errors", lambda *a: calls.append(a) or {"checked": 100}
    )
    config = VerifyMapsConfig(checked=100, output_dir=str(tmp_path))
    for poses in (labelled(), labelled(), labelled(n=500)):
        verify_maps.check_labels(load_robot("panda"), "hard", poses, config, Console())
    assert len(calls) == 2


def test_three_answers_of_whole_poses_are_counted_by_what_is_true():
    poses = labelled()
    poses = replace(poses, wrist_free=poses.wrist_free | poses.strict)

    def said(p, r):
        return np.where(p[:, 0] < 0.5, Reach.REACHABLE, np.where(p[:, 1] < 0.5, Reach.ROLL_NOT_SEEN, Reach.OUTSIDE))

    rows = confusion(load_robot("panda"), a_map("richmap_rolls", reach=said), {"hard": poses})
    assert [row["n"] for row in rows] == [
        poses.strict.sum(),
        (poses.wrist_free & ~poses.strict).sum(),
        (~poses.wrist_free).sum(),
    ]
    assert (
        rows[1]["said at another roll"]
        == (poses.wrist_free & ~poses.strict & (poses.positions[:, 0] >= 0.5) & (poses.positions[:, 1] < 0.5)).sum()
    )
    for row in rows:
        assert row["said reachable"] + row["said at another roll"] + row["said unreachable"] == row["n"]
