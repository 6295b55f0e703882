# Writes OUTPUT, the manual page ernerf-formats(5), from SOURCES in their order, with the program LOWDOWN. The first
# source is docs/formats.md.
set(page "")
foreach(source IN LISTS SOURCES)
  execute_process(COMMAND ${LOWDOWN} -Tman ${source} OUTPUT_VARIABLE text COMMAND_ERROR_IS_FATAL ANY)
  string(APPEND page "\n${text}")
endforeach()
if(NOT page MATCHES "\n\\.SH\nFormats\n")
  message(FATAL_ERROR "${SOURCES}: no heading \"Formats\" that lowdown knows")
endif()
string(REGEX REPLACE "^.*\n\\.SH\nFormats\n" "\n.SH DESCRIPTION\n" page "${page}")
string(REPLACE "\n.SS\n" "\n.SH\n" page "${page}")
string(REGEX REPLACE " <\\\\fI[^>]*\\\\fR>" "" page "${page}") # removes the targets of links
string(REPLACE "\\fC" "\\fB" page "${page}")
file(WRITE ${OUTPUT} "'\\\" t\n.TH ERNERF\\-FORMATS 5 \"\" \"libernerf ${VERSION}\" \"File Formats\"\n.SH NAME\n"
     "ernerf\\-formats \\- files that ernerf reads and writes\n.ad l${page}.SH SEE ALSO\n.BR ernerf (1)\n")
