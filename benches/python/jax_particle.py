"""The whole-array particle filter in JAX: `vmap` and forward derivatives inside one compiled `scan`, 64 bits."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from array_particle import Draws, reading, step
from numpy.typing import NDArray

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_platforms", "cpu")


def run(y: NDArray[np.float64], count: int, linearised: bool) -> NDArray[np.float64]:
    """Mean of the state (T, 10)."""
    return np.asarray(scan(jnp.asarray(y), count, linearised))


@partial(jax.jit, static_argnums=(1, 2))
def scan(y: Any, count: int, linearised: bool) -> Any:
    """One loop over the readings."""

    def body(carry: tuple[Any, Any], readings: tuple[Any, Any]) -> tuple[tuple[Any, Any], Any]:
        now, key = readings
        noise, other, uniform = jax.random.split(key, 3)
        normal = jax.random.normal
        draws = Draws(normal(noise, (count, 6)), normal(other, (count, 4)), jax.random.uniform(uniform))
        x, log = step(jnp, slopes if linearised else None, *carry, now, draws)
        return (x, log), jnp.exp(log) @ x

    keys = jax.random.split(jax.random.key(0), len(y))
    start = jnp.zeros((count, 10)), jnp.full(count, -jnp.log(count))
    return jax.lax.scan(body, start, (y, keys))[1]


@jax.vmap
def slopes(x: Any) -> Any:
    """Readings by the noise of the two accelerations (N, 4, 2)."""
    one = jax.jacfwd(lambda w: reading(jnp, x[None], jnp.concatenate([w, jnp.zeros(4)])[None])[0])
    return one(jnp.zeros(2))
