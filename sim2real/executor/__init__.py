"""Independent, resumable jobs, run in parallel on this machine or on a Ray cluster.

A job is a function called in a new process with its own folder. It writes there all that it needs
to resume after being killed. The folder has the same content wherever the job runs::

    folder/job.json    function and options
    folder/log.txt     output of the job, of all attempts
    folder/done.json   written last, when the job is complete
"""

from sim2real.executor.job import Job, JobOutcome
from sim2real.executor.run import map_jobs, run_jobs

__all__ = ["Job", "JobOutcome", "map_jobs", "run_jobs"]
