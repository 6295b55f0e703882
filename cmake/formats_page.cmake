# OUTPUT: the page ernerf-formats(5) of SOURCE, docs/formats.md, with LOWDOWN.
execute_process(COMMAND ${LOWDOWN} -Tman ${SOURCE} OUTPUT_VARIABLE text COMMAND_ERROR_IS_FATAL ANY)
if(NOT text MATCHES "^(.*\n)?\\.SH\nFormats\n")
  message(FATAL_ERROR "${SOURCE}: begins with no heading \"Formats\" that lowdown knows")
endif()
string(REGEX REPLACE "^(.*\n)?\\.SH\nFormats\n" "" text "${text}") # the name says it
string(REPLACE "\n.SS\n" "\n.SH\n" text "\n${text}")
string(REGEX REPLACE " <\\\\fI[^>]*\\\\fR>" "" text "${text}") # where links lead
string(REPLACE "\\fC" "\\fB" text "${text}")
file(WRITE ${OUTPUT} "'\\\" t\n.TH ERNERF\\-FORMATS 5 \"\" \"libernerf ${VERSION}\" \"File Formats\"\n.SH NAME\n"
     "ernerf\\-formats \\- files that ernerf reads and writes\n.ad l${text}.SH SEE ALSO\n.BR ernerf (1)\n")
