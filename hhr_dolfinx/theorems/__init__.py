"""The theorems of thesis chapter 3: both sides, their constants, for those who want to read what they give away."""
