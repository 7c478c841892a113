"""Control of compiled loops.

`fusion` controls which values are computed in one loop and which are materialised. `primitives`
contains the internal parts of JAX that this needs. `bands` represents a spectrum by one number a
band. `groups` stacks records of equal structure."""
