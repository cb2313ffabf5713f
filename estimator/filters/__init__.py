"""The estimators, one file each: what `registry` finds here, in a tuple `ESTIMATORS`, is known by its name everywhere."""
