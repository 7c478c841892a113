"""The machinery of loops: `fusion` says what one loop computes and what is stored between loops,
`primitives` holds the parts of JAX below its documented interface that this needs, `bands` a
spectrum as one number a band, and `groups` records of equal structure in one stack."""
