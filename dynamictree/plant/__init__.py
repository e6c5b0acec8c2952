"""Find the plant in a source: still parts, up axis, unit, and individual trees."""
