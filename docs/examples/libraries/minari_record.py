import gymnasium
import minari

env = minari.DataCollector(
    gymnasium.make("minitouch_bench:MiniTouch/Pushing-v1"), record_infos=True
)
for seed in range(2):
    env.reset(seed=seed)
    ended = False
    while not ended:
        *_, terminated, truncated, info = env.step(env.action_space.sample())
        ended = terminated or truncated
dataset = env.create_dataset("minitouch/pushing-random-v0")
for episode in dataset.iterate_episodes():
    print(len(episode), "steps,", episode.infos["is_success"].sum(), "successes")
