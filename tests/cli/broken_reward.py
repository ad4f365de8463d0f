"""A plugin whose reward is of the wrong shape, which shows only once a team is paid."""

from robosim.discretise.reward import register_reward

register_reward("broken", lambda outcome: outcome.reward[..., :1])
