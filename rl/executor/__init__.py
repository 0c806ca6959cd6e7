"""Independent, resumable jobs, run side by side on this machine or on a Ray cluster.

A job is a function called in a fresh process on a folder of its own. It keeps there whatever it
needs to go on after being killed at any moment. The folder looks the same wherever the job runs::

    folder/job.json    which function, with which options
    folder/log.txt     what the job printed, all attempts one after the other
    folder/done.json   there once the job is complete; written last
"""

from rl.executor.job import Job, Outcome
from rl.executor.run import run_jobs

__all__ = ["Job", "Outcome", "run_jobs"]
