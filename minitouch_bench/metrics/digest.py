"""The digest of a run: one number that tells whether two runs hold the same bits."""

import hashlib
from collections.abc import Iterable

from minitouch_bench.records import EpisodeMetrics, RunHeader


def run_digest(
    header: RunHeader,
    episodes: Iterable[EpisodeMetrics],
    exploration_episodes: Iterable[EpisodeMetrics] = (),
) -> str:
    """Return the SHA-256 over the rules of each task and the episodes, in the run's order.

    Of an episode it covers the task, index, seed, shape, outcome and the trajectory's own
    digest, and so every metric but ``clipped_actions``. It names neither the policy nor the
    machine: whoever gets the same bits gets the same digest.
    """
    rules = (f"{task} {header.task_digests.get(task, '')}" for task in header.tasks)
    sha = hashlib.sha256("\n".join(rules).encode())
    for role, listed in (("final", episodes), ("exploration", exploration_episodes)):
        for episode in listed:
            identity = (role, episode.task, episode.index, episode.seed, episode.shape)
            result = (episode.outcome.value, episode.digest)
            sha.update(("\n" + " ".join(map(str, (*identity, *result)))).encode())
    return sha.hexdigest()
