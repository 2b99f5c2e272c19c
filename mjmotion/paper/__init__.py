"""The paper's own jobs (§6): a rough terrain, a rope, a morphing body, two transitions."""
