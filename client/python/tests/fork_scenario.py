"""Run by test_fork.py in a process of its own: uses gRPC in a parent, forks or spawns workers, checks both sides.

Arguments: scenario, peer's target. Prints "ok" and exits 0 if every worker got its share.
"""

import multiprocessing
import sys
import threading
import types

if "late" in sys.argv[1]:
    import grpc  # noqa: F401  Before backlot: gRPC starts without fork support.

from backlot import Client, ForkError, Recipe, ShardedSamples, Tls

SNAPSHOT = "librarySnapshots/" + "5" * 64
WORKERS = 4


def work(dataset, worker_id, results):
    try:
        worker = types.SimpleNamespace(id=worker_id, num_workers=WORKERS)
        results.put([sample.index for sample in dataset.iterate(worker)])
    except ForkError:
        results.put("ForkError")


def begun_stream_is_refused(stream, results):
    try:
        next(stream)
        results.put("no error")
    except ForkError:
        results.put("ForkError")


def run_workers(method, dataset):
    context = multiprocessing.get_context(method)
    results = context.Queue()
    workers = [context.Process(target=work, args=(dataset, w, results)) for w in range(WORKERS)]
    for process in workers:
        process.start()
    got = [results.get(timeout=20) for _ in workers]
    for process in workers:
        process.join(10)
        assert process.exitcode == 0, process.exitcode
    return got


def main():
    scenario, target = sys.argv[1], sys.argv[2]
    tls = Tls(open(sys.argv[3], "rb").read(), server_name="localhost") if len(sys.argv) > 3 else None
    client = Client(target, timeout_s=10, sample_timeout_s=10, tls=tls)
    recipe = Recipe(background="assets/street", library_snapshot=SNAPSHOT)
    dataset = ShardedSamples(client, recipe, seed=1, count=24)
    if scenario != "untouched":
        client.list_assets()
    if scenario == "late":
        assert run_workers("fork", dataset) == ["ForkError"] * WORKERS
    elif scenario == "streaming":
        check_while_streaming(client, recipe, dataset)
    else:
        for _ in range(3):
            got = run_workers("spawn" if scenario == "spawn" else "fork", dataset)
            assert sorted(sum(got, [])) == list(range(24)), got
            if scenario == "spawn":
                break
    # The parent goes on.
    assert len(client.list_assets()) == 5
    print("ok")


def check_while_streaming(client, recipe, dataset):
    """Forks again and again while two threads of the parent stream: nobody hangs and nobody misses a sample."""
    seen = [[], []]
    stop = threading.Event()

    def consume(into):
        for sample in client.stream_samples(recipe, seed=1, count=100_000):
            into.append(sample.index)
            if stop.is_set():
                return

    threads = [threading.Thread(target=consume, args=(into,)) for into in seen]
    for thread in threads:
        thread.start()
    inherited = client.stream_samples(recipe, seed=1, count=10)
    next(inherited)
    for _ in range(5):
        got = run_workers("fork", dataset)
        assert sorted(sum(got, [])) == list(range(24)), got
    context = multiprocessing.get_context("fork")
    results = context.Queue()
    process = context.Process(target=begun_stream_is_refused, args=(inherited, results))
    process.start()
    assert results.get(timeout=20) == "ForkError"
    process.join(10)
    assert [sample.index for sample in inherited] == list(range(1, 10))
    lengths = [len(into) for into in seen]
    threading.Event().wait(0.5)
    stop.set()
    for thread, into, length in zip(threads, seen, lengths):
        thread.join(10)
        assert not thread.is_alive() and len(into) > length
        assert into == list(range(len(into)))


if __name__ == "__main__":
    main()
