"""A cluster of this one machine, for tests: every job is a process of its own, as with Slurm.

Jobs live on when the process that sent them is killed.
"""

import subprocess

from snakemake_interface_executor_plugins.executors.base import SubmittedJobInfo
from snakemake_interface_executor_plugins.executors.remote import RemoteExecutor
from snakemake_interface_executor_plugins.settings import CommonSettings

common_settings = CommonSettings(
    non_local_exec=True,
    implies_no_shared_fs=False,
    job_deploy_sources=False,
    pass_default_storage_provider_args=True,
    pass_default_resources_args=True,
    pass_envvar_declarations_to_cmd=False,
    auto_deploy_default_storage_provider=False,
    init_seconds_before_status_checks=0,
)


class Executor(RemoteExecutor):
    """Starts jobs, and asks whether they have ended."""

    def run_job(self, job):
        command = self.format_job_exec(job)
        with open("jobs.log", "a", encoding="utf-8") as log:
            process = subprocess.Popen(
                command, shell=True, stdout=log, stderr=log, start_new_session=True
            )
        with open("jobs.txt", "a", encoding="utf-8") as sent:
            rules = sorted({each.rule.name for each in (job if job.is_group() else [job])})
            sent.write(f"{' '.join(rules)}\n")
        info = SubmittedJobInfo(job, external_jobid=str(process.pid), aux={"process": process})
        self.report_job_submission(info)

    async def check_active_jobs(self, active_jobs):
        for info in active_jobs:
            async with self.status_rate_limiter:
                code = info.aux["process"].poll()
            if code is None:
                yield info
            elif code == 0:
                self.report_job_success(info)
            else:
                self.report_job_error(info)

    def cancel_jobs(self, active_jobs):
        for info in active_jobs:
            info.aux["process"].terminate()
