"""Jobs in threads that start together."""

import threading

THREADS = 8


def at_once(jobs):
    """Results of all jobs, started together in a thread each; the first exception is raised."""
    results, gate = [None] * len(jobs), threading.Barrier(len(jobs))

    def run(k):
        gate.wait()
        try:
            results[k] = jobs[k]()
        except Exception as error:
            results[k] = error

    threads = [threading.Thread(target=run, args=(k,)) for k in range(len(jobs))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for result in results:
        if isinstance(result, Exception):
            raise result
    return results
