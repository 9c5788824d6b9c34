"""Running work in other processes, so that a crash of SUMO ends one piece of work and never the command.

`task_pool.run_local` and `ray_pool.run_ray` do many tasks (`task.Task` in, `task.TaskResult` out) on this machine or on
a Ray cluster; batches and data sets of scenes use them. `worker_process.run_in_worker` calls one function in a process
of its own and passes its progress on; single runs use it. `fork.fork` copies this process together with its simulation,
which is how a branch of the traffic begins. `frozen_process` keeps such a copy waiting, to be copied again. Nothing
here knows what the work is about. Begin reading at `task`.
"""
