"""What W&B keeps on disk can be read back, and nothing waits for a network."""

import json

import pytest
import wandb
from wandb.proto.wandb_internal_pb2 import Record
from wandb.sdk.internal.datastore import DataStore

from benchmark.config import WandbConfig
from benchmark.experiment_log import log_checkpoint, start_experiment


def records(folder) -> list[Record]:
    (file,) = folder.glob("wandb/offline-run-*/run-*.wandb")
    store = DataStore()
    store.open_for_scan(str(file))
    read = []
    while (data := store.scan_data()) is not None:
        record = Record()
        record.ParseFromString(data)
        read.append(record)
    store.close()
    return read


def test_what_was_logged_offline_can_be_read_back(tmp_path):
    (tmp_path / "seed42-1").mkdir()
    (tmp_path / "seed42-1" / "model.safetensors").write_bytes(b"weights")
    config = WandbConfig(mode="offline", folder=str(tmp_path))
    with start_experiment(config, "seed42", "robust", "train", {"steps": 2}) as run:
        run.log({"train/loss": 0.5, "train/lr": 1e-3}, step=1)
        run.log({"validation/p2": 0.99}, step=2)
        log_checkpoint(run, str(tmp_path / "seed42-1"), "robust-seed42-1")
    wandb.teardown()  # Ends the process that writes the file.
    read = records(tmp_path)
    logged = {
        item.nested_key[0] if item.nested_key else item.key: json.loads(item.value_json)
        for record in read
        for item in record.history.item
    }
    assert logged["train/loss"] == 0.5 and logged["train/lr"] == 1e-3 and logged["validation/p2"] == 0.99
    artifacts = [record.request.log_artifact.artifact for record in read if record.HasField("request")]
    artifacts += [record.artifact for record in read if record.HasField("artifact")]
    assert "robust-seed42-1" in {artifact.name for artifact in artifacts}


def test_disabled_leaves_nothing(tmp_path):
    with start_experiment(WandbConfig(folder=str(tmp_path)), "seed42", "robust", "train", {}) as run:
        run.log({"train/loss": 0.5}, step=1)
    assert not list(tmp_path.iterdir())


def test_a_server_that_does_not_answer_means_offline(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("WANDB_BASE_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("WANDB_API_KEY", "x" * 40)
    with start_experiment(WandbConfig(mode="online", folder=str(tmp_path)), "seed42", "robust", "train", {}) as run:
        run.log({"train/loss": 0.5}, step=1)
    assert list(tmp_path.glob("wandb/offline-run-*/run-*.wandb"))
    assert "kept in" in capsys.readouterr().out


def test_an_unknown_mode_is_refused():
    with pytest.raises(ValueError, match="wandb.mode=dryrun is not allowed. Allowed: online, offline, disabled"):
        WandbConfig(mode="dryrun")
