"""The same jobs on a Ray cluster of two nodes, both on this machine."""

import json
from functools import partial

import pytest
from watching import (
    in_background,
    is_alive,
    kill_in_the_middle,
    parent_of,
    process_of,
    reached,
    release,
    results,
    starts,
    uninterrupted,
    wait_for,
    walks,
)

from sim2real.errors import InputError
from sim2real.executor import Job, run_jobs

pytest.importorskip("ray", reason="the extra 'cluster' is not installed")

NODE = {
    "num_cpus": 1,
    "num_gpus": 1,  # Ray hands out what a node is said to have
    "object_store_memory": 80 * 2**20,
    "include_dashboard": False,
}


@pytest.fixture(scope="module")
def cluster():
    """Two nodes of one CPU and one GPU each."""
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args=NODE)
    cluster.add_node(**NODE)
    cluster.wait_for_nodes()
    yield cluster
    cluster.shutdown()


@pytest.fixture
def on_ray(cluster):
    return partial(run_jobs, executor="ray", address=cluster.address)


def test_a_sweep_loses_nothing_when_a_worker_is_killed(on_ray, tmp_path):
    jobs = walks(tmp_path / "run", steps=60, held=[0, 1])
    workers = kill_in_the_middle(jobs[0].folder, parent_of), kill_in_the_middle(jobs[1].folder)
    outcomes = on_ray(jobs)
    assert [str(outcome) for outcome in outcomes] == [f"seed{seed}: done" for seed in range(4)]
    assert all(worker.result() for worker in workers)
    assert [len(starts(job.folder)) for job in jobs] == [2, 2, 1, 1]
    assert all(starts(jobs[killed].folder)[1] >= 30 for killed in (0, 1))
    assert results(tmp_path / "run") == uninterrupted(tmp_path / "reference", steps=60)
    assert run_jobs(jobs) == outcomes  # the folders are those of local processes
    assert [len(starts(job.folder)) for job in jobs] == [2, 2, 1, 1]


def test_failures_are_named_and_the_others_go_on(on_ray, tmp_path):
    jobs = [Job(n, f"random_walk:{n}", {}, tmp_path / n) for n in ("raise_error", "die")]
    outcomes = on_ray([*jobs, *walks(tmp_path, steps=10, count=1)], retries=1)
    whys = ["ValueError: a fish out of water", "killed by SIGKILL, 2 times", None]
    assert [outcome.failure for outcome in outcomes] == whys


@pytest.mark.parametrize(("gpus", "seen"), [(1, "0"), (0, "")])
def test_a_job_sees_the_gpus_it_asked_for(on_ray, tmp_path, gpus, seen):
    job = Job("a", "random_walk:tell_environment", {}, tmp_path / "a")
    on_ray([job], gpus=gpus)
    told = json.loads((job.folder / "environment.json").read_text())
    assert told == {"CUDA_VISIBLE_DEVICES": seen, "OMP_NUM_THREADS": "1"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gpus": 2}, "ray: found 2 nodes too small, expected 1 CPUs and 2 GPUs on one of them"),
        ({"address": "127.0.0.1:9"}, "--address: 127.0.0.1:9: found Connection refused"),
    ],
)
def test_a_job_that_fits_nowhere_is_refused(on_ray, tmp_path, options, message):
    with pytest.raises(InputError, match=message):
        on_ray(walks(tmp_path, steps=10), **options)
    assert not list(tmp_path.iterdir())


def test_a_sweep_loses_nothing_when_a_node_is_lost(cluster, on_ray, tmp_path):
    third = cluster.add_node(**NODE)
    jobs = walks(tmp_path, steps=60, count=3, held=range(3))

    def lose():
        wait_for(lambda: all(reached(job.folder, 30) for job in jobs))
        processes = [process_of(job.folder) for job in jobs]
        cluster.remove_node(third, allow_graceful=False)
        wait_for(lambda: not all(map(is_alive, processes)))  # the node's job ends a little later
        release(tmp_path)
        return True

    lost = in_background(lose)
    outcomes = on_ray(jobs)
    assert [outcome.failure for outcome in outcomes] == [None] * 3
    assert lost.result()
    histories = sorted((starts(job.folder) for job in jobs), key=len)
    assert histories[:2] == [[0], [0]]
    assert histories[2][0] == 0
    assert histories[2][1] >= 30
