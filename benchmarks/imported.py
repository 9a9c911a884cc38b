"""The scripted policy picks up every shape of a set, such as one made by `shapes import`."""

import sys
from collections import Counter

from minitouch_bench.episode import EpisodeSpec, Role
from minitouch_bench.evaluation.rollout import run_episode
from minitouch_bench.policies.scripted import ScriptedPolicy
from minitouch_bench.shapegen.manifest import load_shape_set
from minitouch_bench.tasks.environment import MiniTouchEnv


def main() -> None:
    """Print how many episodes ended how; each shape of the set is played once."""
    shapes = load_shape_set(sys.argv[1])
    environment = MiniTouchEnv("pick-up", objects=shapes)
    policy = ScriptedPolicy(lambda _: environment)
    outcomes: Counter[str] = Counter()
    for index, shape in enumerate(shapes.shapes):
        spec = EpisodeSpec(Role.FINAL, "pick-up", index, index, 0, shape.name)
        outcomes[run_episode(environment, policy, spec).outcome.value] += 1
    environment.close()
    print(f"{len(shapes.shapes)} shapes of {shapes.name}: {dict(outcomes)}")


if __name__ == "__main__":
    main()
