"""Control tasks with a true optimum from a law: a policy that earns more exploits an error of the simulator."""
