  %found = load double, ptr $status, align 8
  %status = select i1 $unsound, double $not_finite, double %found
  store double %status, ptr $status, align 8
  %bad = fcmp oge double %status, $first_bad
  br i1 %bad, label %take.back, label %done

take.back:
$blank
  br label %done

done:
  %code = fptosi double %status to i64
  ret i64 %code
}
