# Doxygen's view of a public header: what the code says itself is said to Doxygen in its own form, line by line.
#   - visit() and enum_names(), which every options struct and enum has, get one sentence each.
#   - Destructors, and copies and moves that are deleted or as usual, are left out: there is nothing to say of them.
{ line[NR] = $0 }

END {
  owner = ""
  for (i = 1; i <= NR; ++i) {
    text = line[i]
    if (match(text, /^(struct|class) [A-Za-z_ ]*/)) owner = type_name(text)
    commented = i > 1 && line[i - 1] ~ /^ *\/\/\//
    bare = text
    sub(/^ *(explicit |\[\[nodiscard\]\] )?/, "", bare)
    if (text ~ /^  template <class Self, class Visitor>/ && line[i + 1] ~ / visit\(/) {
      text = "/** Describes the fields, see core/options.hpp. */" text
    } else if (text ~ /EnumNames<.*> enum_names\(/ && !commented) {
      text = "/** The words for the enumerators in files and on the command line. */" text
    } else if (bare ~ ("^~" owner "\\(") || bare ~ ("^virtual ~" owner "\\(") ||
               bare ~ ("^" owner "\\((const )?" owner "&&?\\)") || bare ~ ("^" owner "& operator=\\(")) {
      text = "/** \\cond */" text "/** \\endcond */"
    }
    print text
  }
}

function type_name(text) {
  sub(/^(struct|class) (LOOPWISE_EXPORT )?/, "", text)
  sub(/[^A-Za-z0-9_].*$/, "", text)
  return text
}
