"""From who stands when to where feet are to go: contacts, footholds, paths, reach, the plan."""
