"""Control of compiled loops.

`fusion` controls which values are computed in one loop and which are materialised. `primitives`
contains the undocumented parts of JAX that `fusion` needs. `bands` represents a spectrum as a tuple
of one number per band. `groups` stacks records of equal structure."""
