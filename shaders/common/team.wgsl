// LANES invocations that run in step, and so can read each other's registers, are a team: they compute neighbouring
// pixels for the same output channels, and each one loads a part of the weights. Where LANES is 1, neighbouring
// invocations compute neighbouring channels instead: what they read of the weights and what they write is contiguous,
// and what they read of the input is the same.
//
// A team computes vectors `group`, `group` + GROUPS, … of the output.
let lane = invocation % LANES;
let group = invocation / LANES % GROUPS;
let block = invocation / (LANES * GROUPS);
