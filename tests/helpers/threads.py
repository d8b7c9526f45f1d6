"""Jobs in threads that start together."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

THREADS = 8


def at_once(jobs):
    """Results of all jobs, started together in a thread each; the first exception is raised."""
    gate = Barrier(len(jobs))

    def run(job):
        gate.wait()
        return job()

    with ThreadPoolExecutor(len(jobs)) as pool:
        return list(pool.map(run, jobs))
