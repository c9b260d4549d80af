"""Lower bounds of all subsets below a node, one module a criterion."""
