"""One thread for linear algebra, and stores of a test's own."""

import os

import pytest

# Small tensors on several threads only wait for each other.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


@pytest.fixture
def artifact_folders(tmp_path, monkeypatch):
    """Empty folders for artifacts, and no request to compute anything anew."""
    from cassie_lib import paths
    from cassie_lib.artifacts import recompute, store

    monkeypatch.setattr(paths, "CACHE", tmp_path / "cache")
    monkeypatch.setattr(paths, "DATA", tmp_path / "data")
    for name in (recompute.REQUEST, recompute.SINCE, store.USED):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(recompute, "_process_since", [])


@pytest.fixture
def figure_folders(tmp_path, monkeypatch):
    """Empty folders for figures and records, of a run with the parameters as they are."""
    from cassie_lib import paths
    from cassie_lib.provenance import CHANGED

    for name in ("CACHE", "FIGURES"):
        monkeypatch.setattr(paths, name, tmp_path / name.lower())
    monkeypatch.delenv(CHANGED, raising=False)


@pytest.fixture(scope="session")
def stage_folder(tmp_path_factory):
    """Where stages that several tests look at are computed once."""
    return tmp_path_factory.mktemp("stages")


@pytest.fixture
def stages(stage_folder, artifact_folders, monkeypatch):
    """A preset that takes seconds, with a store that outlives the test."""
    from cassie_lib import paths
    from cassie_lib.presets import get_preset, replace

    monkeypatch.setattr(paths, "CACHE", stage_folder)
    smoke = get_preset("smoke")
    return replace(
        smoke,
        simulation=replace(smoke.simulation, timestep_s=0.002),
        expert=replace(smoke.expert, total_steps=112, refinement_steps=0),
        reward_only_expert=replace(smoke.reward_only_expert, total_steps=112),
        evaluation=replace(smoke.evaluation, cem_steps=40, planner_steps=30, short_steps=112,
                           oracle_steps=12, oracle_gradient_steps=9),
    )  # fmt: skip


@pytest.fixture
def asked(stages, monkeypatch):
    """Notes what trials of planners ask for instead of running them."""
    from types import SimpleNamespace

    from cassie_lib import planner_pipeline

    found = []

    def note(stage, protocol, model, parameters, expert, **sources):
        del expert
        found.append(SimpleNamespace(stage=stage, protocol=protocol, model=model,
                                     parameters=parameters, **sources))  # fmt: skip
        return "episodes", "artifact"

    monkeypatch.setattr(planner_pipeline, "evaluate", note)
    return found


@pytest.fixture(scope="session")
def offline_run(tmp_path_factory):
    """Folder of a repository whose one notebook ran every stage, small, without any network."""
    from no_network import run_offline

    return run_offline(tmp_path_factory.mktemp("offline"))


@pytest.fixture(scope="session")
def artifact_names(offline_run):
    """Folder name of the artifact of each stage."""
    from pipeline_toys import ARTIFACTS

    from cassie_lib import paths

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(paths, "CACHE", offline_run.cache)
        patched.setattr(paths, "DATA", offline_run.cache / "none")
        return {kind: artifact().name for kind, artifact in ARTIFACTS.items()}


@pytest.fixture
def computed(monkeypatch):
    """What every computation raises instead of being done."""
    from damage_toys import refuse_to_compute

    return refuse_to_compute(monkeypatch)


@pytest.fixture
def stored(offline_run, artifact_names, artifact_folders, computed):
    """Folders of a copy of the artifact of each stage, which may be damaged."""
    from damage_toys import Copies

    from cassie_lib import paths

    return Copies(offline_run.cache, paths.CACHE, artifact_names)
