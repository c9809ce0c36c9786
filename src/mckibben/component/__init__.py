"""What makes a class a component: fields with unit and range, checks, and its form in files."""
